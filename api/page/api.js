// What the server is asked. Where it demands a token, the user is asked for it once a tab.

const KEY = "furrow-token";

/** A refusal as the server words it. */
export class Problem extends Error {
  constructor(document, status) {
    super(document.detail || document.title || `the server answered ${status}`);
    this.status = status;
    this.key = document.key;
    this.allowed = document.allowed ?? [];
  }
}

export const hasToken = () => sessionStorage.getItem(KEY) !== null;

const authorization = () => (hasToken() ? { authorization: `Bearer ${sessionStorage.getItem(KEY)}` } : {});

let asking = null;

/** Asks for a token; several requests wait for the same answer. */
function askForToken(reason) {
  asking ??= new Promise((resolve) => {
    const dialog = document.getElementById("token");
    const [text, error] = [document.getElementById("token-text"), document.getElementById("token-error")];
    error.hidden = !hasToken();
    error.textContent = reason;
    text.value = "";
    dialog.addEventListener(
      "close",
      () => {
        if (text.value) sessionStorage.setItem(KEY, text.value.trim());
        asking = null;
        resolve(text.value !== "");
      },
      { once: true },
    );
    dialog.showModal();
  });
  return asking;
}

async function problem(response) {
  const text = await response.text();
  try {
    return new Problem(JSON.parse(text), response.status);
  } catch {
    return new Problem({ detail: text }, response.status);
  }
}

/** A good answer; throws a `Problem` for any other. */
export async function ask(path, { method = "GET", body, headers = {}, signal } = {}) {
  const given = body === undefined ? {} : { "content-type": "application/json" };
  const send = () =>
    fetch(path, {
      method,
      signal,
      body: body === undefined ? undefined : JSON.stringify(body),
      headers: { ...given, ...headers, ...authorization() },
    });
  let response = await send();
  while (response.status === 401) {
    if (!(await askForToken((await problem(response)).message)))
      throw new Problem({ detail: "no token was given" }, 401);
    response = await send();
  }
  if (!response.ok) throw await problem(response);
  return response;
}

export const getJson = async (path, signal) => (await ask(path, { signal })).json();

export const getBlob = async (path, signal) => (await ask(path, { signal })).blob();

export async function change(method, path, body, headers) {
  const response = await ask(path, { method, body, headers });
  return response.status === 204 ? null : response.json();
}

/** `path` with these parameters; those without a value are left out. */
export function withParams(path, params) {
  const given = Object.entries(params).filter(([, value]) => value !== undefined && value !== null);
  const query = new URLSearchParams(given).toString();
  return query ? `${path}?${query}` : path;
}
