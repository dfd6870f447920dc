// Server-sent events over `fetch`, which can send a token. Closed while the tab is hidden: browsers allow a server few
// connections at a time.

import { ask, Problem } from "./api.js";

const FIRST_PAUSE_MS = 1_000;
const LONGEST_PAUSE_MS = 15_000;

/** Splits text that comes in pieces into [event, data]. */
function reader(tell) {
  let rest = "";
  return (piece) => {
    rest += piece;
    let end;
    while ((end = rest.indexOf("\n\n")) >= 0) {
      const lines = rest.slice(0, end).split("\n");
      rest = rest.slice(end + 2);
      const field = (name) =>
        lines.filter((line) => line.startsWith(`${name}:`)).map((line) => line.slice(name.length + 1).trim());
      const data = field("data");
      if (data.length > 0) tell(field("event")[0] ?? "message", JSON.parse(data.join("\n")));
    }
  };
}

async function follow(path, tell, signal) {
  const response = await ask(path, { signal, headers: { accept: "text/event-stream" } });
  const [pieces, decoder, read] = [response.body.getReader(), new TextDecoder(), reader(tell)];
  for (;;) {
    const { done, value } = await pieces.read();
    if (done) return;
    read(decoder.decode(value, { stream: true }));
  }
}

/** Calls `handlers[event](data)` until `signal` is aborted or the event `end` came. */
export function listen(path, handlers, signal) {
  let [connection, ended, pause, timer] = [null, false, FIRST_PAUSE_MS, null];
  const tell = (event, data) => {
    pause = FIRST_PAUSE_MS;
    ended ||= event === "end";
    handlers[event]?.(data);
  };
  const open = async () => {
    if (connection || ended || signal.aborted || document.hidden) return;
    connection = new AbortController();
    try {
      await follow(path, tell, connection.signal);
    } catch (error) {
      if (error instanceof Problem && [401, 403, 404].includes(error.status)) ended = true;
    }
    connection = null;
    if (ended || signal.aborted) return;
    timer = setTimeout(open, pause);
    pause = Math.min(2 * pause, LONGEST_PAUSE_MS);
  };
  const seen = () => {
    clearTimeout(timer);
    if (document.hidden) connection?.abort();
    else open();
  };
  document.addEventListener("visibilitychange", seen, { signal });
  signal.addEventListener("abort", () => {
    clearTimeout(timer);
    connection?.abort();
  });
  open();
}
