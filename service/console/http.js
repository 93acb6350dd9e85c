// How the page talks to the service: requests, problems, event streams. Nothing here draws.

/** An answer that is an error: the members of the problem document, and the status; 0 without
    an answer. */
export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `HTTP ${status}`);
    Object.assign(this, body, { status });
  }
}

export const address = (path, parameters = {}) => {
  const given = Object.entries(parameters).filter(([, value]) => value != null && value !== "");
  const pairs = given.flatMap(([name, value]) => [value].flat().map((each) => [name, each]));
  return pairs.length ? `${path}?${new URLSearchParams(pairs)}` : path;
};

/** Send a request; return JSON as a value and all else as text. Throws a Problem. */
export async function ask(path, { method = "GET", body, type, accept = "application/json" } = {}) {
  const headers = { Accept: accept };
  if (body !== undefined) {
    headers["Content-Type"] = type ?? "application/json";
    if (typeof body !== "string") body = JSON.stringify(body);
  }
  let answer;
  try {
    answer = await fetch(path, { method, body, headers });
  } catch {
    throw new Problem(0, { title: "no connection", detail: "The service does not answer." });
  }
  const text = await answer.text();
  const isJson = (answer.headers.get("content-type") ?? "").includes("json");
  if (!answer.ok) {
    throw new Problem(answer.status, isJson ? JSON.parse(text) : { title: answer.statusText });
  }
  return isJson && text ? JSON.parse(text) : text;
}

/** An explanation. Where there is no plan, it is the problem, which has the same members. */
export const explain = (body) => ask("/explain", { method: "POST", body }).catch((error) => {
  if (!error.stages) throw error;
  return error;
});

/** The messages of whole blocks of an event stream, and the id of the last one. */
export function messages(text) {
  const found = [];
  let last = null;
  for (const block of text.split("\n\n")) {
    let event = "message", data = "";
    for (const line of block.split("\n")) {
      if (line.startsWith("data: ")) data += line.slice(6);
      else if (line.startsWith("id: ")) last = line.slice(4);
      else if (line.startsWith("event: ")) event = line.slice(7);
    }
    if (data) found.push({ event, ...JSON.parse(data) });
  }
  return [found, last];
}

const FIRST_WAIT = 500, LONGEST_WAIT = 15_000;

/** Follow an event stream until the returned function is called; resume it after a lost connection.

    `take` gets an array of messages for each chunk that arrives, and when the page began to read it. `state` gets open, waiting, failed,
    or ended: all `number` streams of the address have ended, and nothing follows. Not EventSource:
    that hides status and problem, cannot send Last-Event-ID first, and calls once a message. */
export function follow(path, take, state = () => {}, number = 1) {
  const stop = new AbortController();
  let last = null, wait = FIRST_WAIT;

  /** Whether the connection has ended because its streams have. */
  async function connect() {
    const headers = last ? { "Last-Event-ID": last } : {};
    const answer = await fetch(path, { signal: stop.signal, headers });
    if (!answer.ok) throw new Problem(answer.status, await answer.json().catch(() => ({})));
    const isNew = last === null;
    last ??= answer.headers.get("Dyknow-Position");
    state("open", isNew ? last : null);
    wait = FIRST_WAIT;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    const ended = new Set();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return ended.size >= number;
      rest += value;
      const end = rest.lastIndexOf("\n\n");
      if (end < 0) continue;
      const begun = performance.now(), [found, id] = messages(rest.slice(0, end));
      rest = rest.slice(end + 2);
      last = id ?? last;
      for (const { event, stream, reason } of found) {
        // A stream that has ended may go on; a removed one may be declared again.
        if (event === "end" && reason !== "removed") ended.add(stream);
        else ended.delete(stream);
      }
      if (found.length) take(found, begun);
    }
  }

  async function run() {
    while (!stop.signal.aborted) {
      try {
        if (await connect()) return stop.signal.aborted || state("ended");
      } catch (error) {
        if (stop.signal.aborted) return;
        if (error.status >= 400 && error.status < 500 && error.status !== 429) {
          if (last === null) return state("failed", error);
          // The service has begun a new epoch, or has forgotten these samples: begin anew.
          last = null;
          take([{ event: "gap", detail: error.message }], performance.now());
        }
      }
      if (stop.signal.aborted) return;
      state("waiting");
      await new Promise((done) => setTimeout(done, wait * (0.5 + Math.random())));
      wait = Math.min(wait * 2, LONGEST_WAIT);
    }
  }

  run();
  return () => stop.abort();
}
