// The routes of this server, from the document that it makes of itself.

import { getJson } from "./api.js";
import { h, put } from "./dom.js";
import { heading, listing, note, trouble } from "./frame.js";

const DEEPEST = 3;
const main = document.getElementById("main");

/** Text in which what stands in backticks is code. */
const coded = (text) => text.split("`").map((part, i) => (i % 2 === 1 ? h("code", {}, part) : part));

/** What a schema allows, in words: `{id: integer, name: string}`. */
function shape(schema, schemas, depth = 0) {
  if (!schema) return "anything";
  if (schema.$ref) {
    const name = schema.$ref.split("/").at(-1);
    return depth < DEEPEST ? shape(schemas[name], schemas, depth + 1) : name;
  }
  const inner = (one) => shape(one, schemas, depth + 1);
  const several = schema.oneOf ?? schema.anyOf;
  if (several) return several.map(inner).join(" | ");
  if (schema.allOf) return schema.allOf.map(inner).join(" & ");
  if (schema.enum) return schema.enum.map((value) => JSON.stringify(value)).join(" | ");
  const types = [schema.type ?? "object"].flat();
  return types
    .map((type) => {
      if (type === "array")
        return schema.prefixItems ? `[${schema.prefixItems.map(inner).join(", ")}]` : `[${inner(schema.items)}, ..]`;
      if (type !== "object" || !schema.properties)
        return type === "object" && schema.additionalProperties
          ? `{name: ${inner(schema.additionalProperties)}}`
          : type;
      const [indent, required] = ["  ".repeat(depth + 1), schema.required ?? []];
      const lines = Object.entries(schema.properties).map(([name, value]) => {
        const about = value.description ? `  // ${value.description.split("\n")[0]}` : "";
        return `${indent}${name}${required.includes(name) ? "" : "?"}: ${inner(value)}${about}`;
      });
      return `{\n${lines.join("\n")}\n${"  ".repeat(depth)}}`;
    })
    .join(" | ");
}

function bodies(content, schemas) {
  return Object.entries(content ?? {}).map(([mediaType, { schema }]) => [
    h("p", { class: "muted" }, mediaType),
    schema && h("pre", { tabindex: "0" }, shape(schema, schemas)),
  ]);
}

function route(path, method, operation, schemas) {
  const parameters = operation.parameters ?? [];
  const answers = Object.entries(operation.responses ?? {}).filter(([status]) => status !== "default");
  return h(
    "details",
    { class: "route", id: operation.operationId },
    h(
      "summary",
      {},
      h("span", { class: `method ${method}` }, method.toUpperCase()),
      h("code", {}, path),
      h("span", { class: "muted" }, coded(operation.summary ?? "")),
    ),
    operation.description && h("p", {}, coded(operation.description)),
    parameters.length > 0 &&
      listing(
        `Parameters of ${path}`,
        ["Parameter", "In", "Type", "What"],
        parameters.map((one) => [
          h("code", {}, one.name),
          one.in + (one.required ? ", required" : ""),
          shape(one.schema, schemas, DEEPEST),
          coded(one.description ?? ""),
        ]),
      ),
    operation.requestBody && [h("h3", {}, "Body"), bodies(operation.requestBody.content, schemas)],
    answers.map(([status, answer]) => [
      h("h3", {}, `${status} ${answer.description ?? ""}`),
      bodies(answer.content, schemas),
    ]),
  );
}

async function show() {
  const { info, paths, components } = await getJson("/openapi.json");
  const tags = new Map();
  for (const [path, methods] of Object.entries(paths)) {
    for (const [method, operation] of Object.entries(methods)) {
      const tag = operation.tags?.[0] ?? "other";
      tags.set(tag, [...(tags.get(tag) ?? []), route(path, method, operation, components.schemas)]);
    }
  }
  const sections = [...tags].map(([tag, routes]) => h("section", { class: "card" }, h("h2", {}, tag), routes));
  put(
    main,
    heading("API"),
    note(
      info.description,
      " The whole document is at ",
      h("a", { href: "/openapi.json" }, "/openapi.json"),
      ". What goes wrong is answered as ",
      h("code", {}, "application/problem+json"),
      ", which names the key at fault and what is allowed.",
    ),
    sections,
  );
  document.getElementById(location.hash.slice(1))?.setAttribute("open", "");
}

show().catch((error) => put(main, heading("API"), trouble(error)));
