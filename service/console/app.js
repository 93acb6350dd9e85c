// The frame: pages, keys, theme, what is wrong. A page is loaded when it is first opened.
import { effect, html, render, signal, useEffect, useRef } from "./vendor/preact.js";
import { connection, held, history, requests, session, start, status, streams, wrong } from "./state.js";
import { count, plural, rate } from "./format.js";
import { ask } from "./http.js";
import { say, theme, toast } from "./widgets.js";
import { Login } from "./login.js";

const PAGES = { live: "Live", graph: "Graph", ask: "Ask", query: "Query", system: "System" };
const KEYS = [
  ["1 … 5", "the pages"], ["/", "search on this page"], ["p", "hold what moves, and go on"],
  ["Ctrl ⏎", "run, or start"], ["← →", "in the graph: along the chain"],
  ["t", "light or dark"], ["Esc", "leave a field, close this"],
];
/** The address after #: page, then what is shown on it. */
const route = signal({ page: "live", rest: "" });
const loaded = signal({}), help = signal(false);

function read() {
  const [page, ...rest] = location.hash.slice(1).split("/");
  const name = page in PAGES ? page : "live";
  route.value = { page: name, rest: rest.map(decodeURIComponent).join("/") };
  load(name);
}

function load(name) {
  if (loaded.value[name]) return;
  import(`./pages/${name}.js`).then((module) => {
    loaded.value = { ...loaded.value, [name]: module.default };
  }).catch(() => say(`${PAGES[name]} has not been loaded: the service does not answer`));
}

function press(event) {
  if (event.key === "Escape") return document.activeElement?.blur();
  const target = event.composedPath()[0];
  const isTyping = target.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName);
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
  const page = Object.keys(PAGES)[Number(event.key) - 1];
  if (page) location.hash = page;
  else if (event.key === "p") held.value = !held.value;
  else if (event.key === "t") turn();
  else if (event.key === "?") help.value = true;
  else if (event.key === "/") {
    event.preventDefault();
    document.querySelector("main input[type=search]")?.focus();
  }
}
const turn = () => { theme.value = theme.value === "dark" ? "light" : "dark"; };

function Help() {
  const box = useRef();
  useEffect(() => {
    if (help.value) box.current.showModal();
    else box.current.close();
  }, [help.value]);
  return html`<dialog ref=${box} aria-label="Keys" onClose=${() => { help.value = false; }}>
    <h2>Keys</h2><dl class="facts">${KEYS.map(([key, does]) => html`<dt><kbd>${key}</kbd></dt><dd>${does}</dd>`)}</dl>
    <button onClick=${() => { help.value = false; }}>Close</button></dialog>`;
}

function Connection() {
  const isStarting = connection.value === "open" && status.value.starting.length > 0;
  const state = isStarting ? "starting" : connection.value, dot = { open: "on", waiting: "bad" }[state] ?? "";
  const words = isStarting ? html`<a href="#system" title=${status.value.starting.join("; ")}>starting</a>`
    : state === "open" ? "connected" : state;
  return html`<span class="row small muted" role="status"><i class=${`dot ${dot}`}></i><span class="wide">${words}</span></span>`;
}

function Counts() {
  const now = history.value.at(-1), states = Map.groupBy(requests.value, (each) => each.state);
  const number = (state) => states.get(state)?.length ?? 0;
  const apart = ["failed", "ended"].filter(number).map((state) => `, ${count(number(state))} ${state}`);
  return html`<span class="row counts small muted num wide">
    <span>${plural(streams.value.length, "stream")}</span><span>${plural(requests.value.length - number("failed") - number("ended"), "request")}${apart}</span>
    <span class="rates">${rate(now?.in)} in</span><span class="rates">${rate(now?.out)} out</span></span>`;
}

async function leave() {
  await ask("/session", { method: "DELETE" });
  location.reload();
}

function App() {
  const { page, rest } = route.value, Page = loaded.value[page];
  const link = (name, label) => html`<a href=${`#${name}`} aria-current=${name === page ? "page" : null}>${label}
    ${name === "system" && wrong.value.length > 0
      && html`<span class=${`badge ${wrong.value[0].level}`} title="problems">${wrong.value.length}</span>`}</a>`;
  const isOut = connection.value === "login";
  return html`
    <header class="top">
      <a class="brand" href="#live">DyKnow</a>
      <nav class="nav" aria-label="Pages">${Object.entries(PAGES).map(([name, label]) => link(name, label))}</nav>
      <h1 class="hidden">${PAGES[page]}</h1><span class="grow"></span>
      <${Counts} /><${Connection} />
      <button class="plain" aria-pressed=${held.value} title="hold what moves (p)"
        onClick=${() => { held.value = !held.value; }}>${held.value ? html`<b class="accent">Go on</b>` : "Hold"}</button>
      <button class="plain" title="light or dark (t)" onClick=${turn}>${theme.value === "dark" ? "Light" : "Dark"}</button>
      ${session.value.name && html`<button class="plain wide" onClick=${leave} title=${`of ${session.value.name}`}>Log out</button>`}
      <button class="plain wide" aria-label="keys" onClick=${() => { help.value = true; }}>?</button>
    </header>
    ${isOut ? html`<${Login} />` : Page ? html`<${Page} rest=${rest} key=${page} />` : html`<main class="page"></main>`}
    <${Help} />
    ${toast.value && html`<div class="toast" role="status">${toast.value.text}
      ${toast.value.undo && html`<button class="plain" onClick=${() => { toast.value.undo(); toast.value = null; }}>Undo</button>`}</div>`}`;
}

effect(() => {
  document.documentElement.dataset.theme = localStorage.theme = theme.value;
});
effect(() => {
  const number = wrong.value.length;
  document.title = `${number ? `(${number}) ` : ""}${PAGES[route.value.page]} · DyKnow`;
});
addEventListener("hashchange", read);
addEventListener("keydown", press);
read();
start();
render(html`<${App} />`, document.getElementById("app"));
// The small pages at once, so that they are there when the service is not. Query has the editor.
setTimeout(() => Object.keys(PAGES).filter((name) => name !== "query").forEach(load), 1_000);
