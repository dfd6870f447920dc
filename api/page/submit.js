// A form for a new sweep, made from the plans that the server knows.

import { change, getJson, Problem } from "./api.js";
import { h, put, uniqueId } from "./dom.js";
import { count, several } from "./format.js";
import { heading, note } from "./frame.js";
import { literal, literals, parameterRows, parametersOf, readRows } from "./parameters.js";

/** A labelled input with room for what is wrong with it. */
function field(key, label, control, hint) {
  const [id, described] = [uniqueId("field"), uniqueId("about")];
  control.id = id;
  control.setAttribute("aria-describedby", described);
  return h(
    "div",
    { class: "field", "data-key": key },
    h("label", { for: id }, label),
    control,
    h("p", { class: "hint", id: described }, hint),
    h("p", { class: "error", role: "alert", hidden: true }),
  );
}

function levels(factor, changed) {
  const boxes = factor.labels.map((label) => {
    const id = uniqueId("level");
    return h(
      "div",
      { class: "check" },
      h("input", { type: "checkbox", id, value: label, checked: true, onchange: changed }),
      h("label", { for: id }, label),
    );
  });
  const all = (checked) => () => {
    boxes.forEach((box) => {
      box.firstChild.checked = checked;
    });
    changed();
  };
  return h(
    "fieldset",
    { class: "levels", "data-key": factor.name },
    h("legend", {}, factor.name),
    factor.labels.length > 1 &&
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", class: "small", onclick: all(true) }, "All"),
        h("button", { type: "button", class: "small", onclick: all(false) }, "None"),
      ),
    h("div", { class: "checks" }, boxes),
    h("p", { class: "error", role: "alert", hidden: true }),
  );
}

function read(form, plan, own) {
  const body = { plan: plan.name, only: {}, set: readRows(form, "set", literal), vary: readRows(form, "vary", literals) };
  if (own) body.field = own;
  for (const factor of plan.factors.filter(({ name }) => !own || name !== "field")) {
    const boxes = [...form.querySelectorAll(`fieldset[data-key="${CSS.escape(factor.name)}"] input`)];
    const chosen = boxes.filter((box) => box.checked).map((box) => box.value);
    if (chosen.length < boxes.length) body.only[factor.name] = chosen;
  }
  const [seeds, name, priority] = ["seeds", "name", "priority"].map((key) =>
    form.querySelector(`[data-key="${key}"] input`).value.trim(),
  );
  if (seeds !== "") body.seeds = literal(seeds);
  if (name !== "") body.name = name;
  if (priority !== "") body.priority = literal(priority);
  for (const key of ["record", "timing"]) body[key] = form.querySelector(`input[name="${key}"]`).checked;
  return body;
}

/** Where a refusal belongs: the field of its key, the parameter of its path, else the form. */
function placeOf(form, problem) {
  const key = problem.key ?? "";
  const settings = [...form.querySelectorAll(".setting")];
  const row =
    settings.find((one) => one.querySelector(".path").value.trim() === key) ??
    settings.find((one) => key.endsWith(one.querySelector(".path").value.trim() || "\0"));
  const own = form.querySelector("[data-key='own']");
  if (/^field\b/.test(key) && own.querySelector("input").files.length > 0) return own;
  const keys = [key, key.split(".").at(-1), key.split(/[.[]/)[0]];
  const named = keys.map((one) => one && form.querySelector(`[data-key="${CSS.escape(one)}"]`)).find(Boolean);
  return row ?? named ?? form.querySelector("[data-key='']");
}

function show(form, problem) {
  const place = placeOf(form, problem);
  const error = place.querySelector(".error");
  error.hidden = false;
  error.textContent =
    problem.allowed?.length > 0 && !problem.message.includes(problem.allowed[0])
      ? `${problem.message} Allowed: ${problem.allowed.slice(0, 20).join(", ")}`
      : problem.message;
  const control = place.querySelector("input, select");
  control?.setAttribute("aria-invalid", "true");
  (control ?? place).focus();
  place.scrollIntoView({ block: "nearest" });
}

function forget(form) {
  for (const error of form.querySelectorAll(".error")) error.hidden = true;
  for (const control of form.querySelectorAll("[aria-invalid]")) control.removeAttribute("aria-invalid");
}

export async function showSubmit(main, { query, signal }) {
  const [{ items: plans }, ...parts] = await Promise.all(
    ["/v1/plans", "/v1/fields", "/v1/algorithms"].map((path) => getJson(path, signal)),
  );
  const choices = parts.flatMap((part) => part.items);
  const [about, factors, jobs] = [
    h("div", {}),
    h("div", { class: "factors" }),
    h("p", { class: "jobs", "aria-live": "polite" }),
  ];
  let plan = plans.find((one) => one.name === query.get("plan")) ?? plans[0];
  const sources = [...new Set(plans.map((one) => one.name.split("/")[0]))];
  const list = h(
    "select",
    { onchange: (event) => choose(event.target.value) },
    sources.map((source) =>
      h(
        "optgroup",
        { label: source },
        plans
          .filter((one) => one.name.split("/")[0] === source)
          .map((one) => h("option", { value: one.name, selected: one === plan }, one.name)),
      ),
    ),
  );
  const input = (type, more) => h("input", { type, autocomplete: "off", ...more });
  const known = () => parametersOf(plan, choices);
  const settings = parameterRows(
    { word: "set", adds: "Add a parameter", value: "20", hint: "Value" },
    known,
    () => size(),
  );
  const varied = parameterRows(
    { word: "vary", adds: "Add a factor", value: "5, 10, 20", hint: "Values, with commas" },
    known,
    () => size(),
  );
  // The user's own field, once a file with one is chosen.
  let own = null;
  const file = input("file", { accept: ".json,application/json", onchange: chooseField });
  const check = (name, label, hint) => {
    const id = uniqueId(name);
    return h(
      "div",
      { class: "check" },
      h("input", { type: "checkbox", name, id }),
      h("label", { for: id }, label, h("span", { class: "hint" }, hint)),
    );
  };
  const submit = h("button", { type: "submit", class: "primary" }, "Submit the sweep");
  const form = h(
    "form",
    { class: "submit", novalidate: true, onsubmit: send, oninput: size },
    h("section", { class: "card" }, h("h2", {}, "Plan"), field("plan", "Plan", list, ""), about),
    h("section", { class: "card" }, h("h2", {}, "Levels"), factors),
    h(
      "section",
      { class: "card" },
      h("h2", {}, "Runs"),
      h(
        "div",
        { class: "fields" },
        field("seeds", "Seeds", input("number", { min: 1, step: 1 }), "Every combination runs with seeds 1 to this."),
        field("name", "Name", input("text", { maxlength: 200 }), "The plan's, if left empty."),
        field("priority", "Priority", input("number", { step: 1, placeholder: "0" }), "Higher goes first."),
      ),
      h(
        "div",
        { class: "checks wide" },
        check("record", "Keep the paths", "Otherwise they are run again when asked for."),
        check("timing", "Measure times", "Nothing cached counts, and workers run one job at a time."),
      ),
    ),
    h(
      "section",
      { class: "card" },
      h("h2", {}, "Parameters"),
      note("A dotted path in the scenario, and its value in every run."),
      settings.element,
      h("h3", {}, "Varied"),
      note("A further factor: the values that a parameter takes, with commas."),
      varied.element,
    ),
    h(
      "section",
      { class: "card" },
      h("h2", {}, "Your own field"),
      field("own", "Field file", file, "JSON; it takes the place of the plan's fields."),
    ),
    h(
      "section",
      { class: "card send", "data-key": "" },
      jobs,
      submit,
      h("p", { class: "error", role: "alert", hidden: true }),
    ),
  );

  function size() {
    const product = plan.factors.reduce(
      (total, factor) =>
        total * factors.querySelectorAll(`fieldset[data-key="${CSS.escape(factor.name)}"] input:checked`).length,
      1,
    );
    const values = Object.values(readRows(form, "vary", literals));
    const cells = values.reduce((total, those) => total * those.length, own ? withoutFields(product) : product);
    const seeds = Number(form.querySelector("[data-key='seeds'] input").value || plan.seeds);
    jobs.textContent =
      product === 0
        ? "No level of a factor is chosen."
        : `${several(cells, "cell")} \u00d7 ${several(seeds, "seed")} = ${count(cells * seeds)} runs or more`;
  }
  const withoutFields = (product) => {
    const boxes = factors.querySelectorAll("fieldset[data-key='field'] input:checked");
    return boxes.length > 0 ? product / boxes.length : product;
  };
  async function chooseField() {
    own = null;
    forget(form);
    try {
      if (file.files[0]) own = JSON.parse(await file.files[0].text());
    } catch (error) {
      show(form, { key: "own", message: `${file.files[0].name} is no JSON: ${error.message}` });
      file.value = "";
    }
    size();
  }
  function choose(name) {
    plan = plans.find((one) => one.name === name);
    put(about, h("p", {}, plan.title), note(plan.source));
    put(
      factors,
      plan.factors.map((factor) => levels(factor, size)),
    );
    form.querySelector("[data-key='seeds'] input").placeholder = String(plan.seeds);
    settings.refresh();
    varied.refresh();
    size();
  }
  // One key a visit and content: a doubled click makes no second sweep.
  let [key, sent] = [null, null];
  async function send(event) {
    event.preventDefault();
    forget(form);
    const body = read(form, plan, own);
    if (JSON.stringify(body) !== sent)
      [key, sent] = [crypto.getRandomValues(new Uint32Array(4)).join("-"), JSON.stringify(body)];
    submit.disabled = true;
    try {
      const created = await change("POST", "/v1/sweeps", body, { "idempotency-key": key });
      location.hash = `#/sweeps/${created.id}`;
    } catch (error) {
      show(form, error instanceof Problem ? error : { message: `The server cannot be reached: ${error.message}` });
    } finally {
      submit.disabled = false;
    }
  }
  put(main, heading("New sweep", [["Sweeps", "#/"]]), form);
  choose(plan.name);
}
