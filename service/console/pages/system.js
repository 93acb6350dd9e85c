// Is it well? The problems first, then load, streams by rate, and the changes.
import { html, useEffect, useState } from "../vendor/preact.js";
import { changes, connection, history, may, silence, status, streams, title, transformations, units, wrong } from "../state.js";
import { ago, bytes, clock, count, duration, plural, rate } from "../format.js";
import { ask } from "../http.js";
import { Empty, Plot, Spark, theme } from "../widgets.js";

const SPARKS = 60, LISTED = 200, SMOOTHED = 6, POLL = 10_000, REFUSED = 400, FAILED = 500;
const COLUMNS = {
  name: ["stream", (each) => each.name], rate: ["rate", (each) => -each.rate],
  last: ["last", (each) => -(silence(each) ?? Infinity)], late: ["late", (each) => -each.counters.late],
  kept: ["kept", (each) => -each.kept],
};

const Tile = ({ name, shown, small, children }) => html`<section class="panel tile" aria-label=${name}>
  <h2>${name}</h2><div class="value">${shown} <small>${small}</small></div>
  <div class="small faint">${children}</div></section>`;

function Tiles() {
  const now = status.value, past = history.value, load = past.at(-1);
  const sparks = (key) => html`<${Spark} points=${past.slice(-SPARKS).map((each) => each[key])} />`;
  const before = past.at(-SMOOTHED);
  const busy = before ? (load.processor - before.processor) / (load.time - before.time) : null;
  const isReady = connection.value === "open" && !wrong.value.some((each) => each.kind === "service" && each.level === "bad");
  const starting = now?.starting ?? [];
  const ready = connection.value === "open" && starting.length ? "Starting" : isReady ? "Yes" : "No";
  const used = load?.memory_limit ? (100 * load.memory) / load.memory_limit : null;
  return html`<div class="tiles">
    <${Tile} name="Ready" shown=${ready} small=${now && `for ${duration((Date.parse(now.now) - Date.parse(now.started)) / 1000)}`}>
      ${starting[0] ?? (now && `version ${now.version}`)}<//>
    <${Tile} name="Samples in" shown=${rate(load?.in)} small=${now && `${count(now.accepted)} in all`}>${sparks("in")}<//>
    <${Tile} name="Results out" shown=${rate(load?.out)} small=${now && `${plural(now.clients, "follower")}`}>${sparks("out")}<//>
    <${Tile} name="Memory" shown=${bytes(load?.memory)} small=${load?.memory_limit ? `of ${bytes(load.memory_limit)}` : ""}>
      ${used !== null && html`<div class="bar"><i class=${used > 90 ? "bad" : ""} style=${{ width: `${Math.min(100, used)}%` }}></i></div>`}<//>
    <${Tile} name="Processor" shown=${busy === null ? "–" : `${Math.round(100 * busy)} %`} small="of one">
      event loop late by ${duration(load?.loop_lag)}<//>
    <${Tile} name="Journal" shown=${load?.log_waiting == null ? "None" : "On"} small=${load?.log_waiting == null ? "all is in memory" : `${count(load.log_waiting)} wait`}>
      ${load?.log_waiting == null && html`<code>--data DIR</code> keeps it`}<//></div>`;
}

/** The page that shows where a problem is. */
const whereabouts = (problem) => problem.stream ? `#graph/${encodeURIComponent(problem.stream)}` : null;

function Problems() {
  const list = wrong.value;
  return html`<section class="panel w5" aria-label="problems"><header><h2 class="grow">Problems</h2>
    <span class="faint small num">${list.length || ""}</span></header>
    <div class="scroll cap" tabindex="0">${list.map((each) => html`<div class="problem" key=${each.what}>
      <i class=${`dot ${each.level}`}></i><b class=${each.level}>${each.what}</b>
      ${whereabouts(each) ? html`<a class="small" href=${whereabouts(each)}>Look</a>` : html`<span></span>`}
      <p>${each.detail} ${each.hint}</p></div>`)}
    ${!list.length && html`<${Empty} title="Nothing is wrong."><span>Silent and late streams, units that fail or fall behind,
      lost windows, short memory and a lost connection appear here, each with the remedy.</span><//>`}</div></section>`;
}

function Streams() {
  const [order, setOrder] = useState("rate");
  const list = [...streams.value].sort((a, b) => {
    const [x, y] = [COLUMNS[order][1](a), COLUMNS[order][1](b)];
    return x < y ? -1 : x > y ? 1 : 0;
  });
  const head = (key) => html`<th class=${key === "name" ? "" : "num"} aria-sort=${order === key ? "descending" : null}>
    <button class="plain" onClick=${() => setOrder(key)}>${COLUMNS[key][0]}${order === key ? " ↓" : ""}</button></th>`;
  return html`<section class="panel w7" aria-label="streams"><header><h2 class="grow">Streams</h2>
    <span class="faint small num">${list.length}</span></header><div class="scroll cap" tabindex="0"><table>
    <thead><tr>${head("name")}<th class="wide">meaning</th>${["rate", "last", "late", "kept"].map(head)}</tr></thead>
    <tbody>${list.slice(0, LISTED).map((each) => html`<tr key=${each.name}>
      <td><a class="mono" href=${`#graph/${encodeURIComponent(each.name)}`}>${each.name}</a></td>
      <td class="muted cut wide meaning">${each.ports.length ? title(each) : html`<span class="faint">–</span>`}</td>
      <td class="num">${each.ended ? html`<span class="faint">ended</span>` : rate(each.rate)}</td><td class="num">${ago(silence(each))}</td>
      <td class=${`num ${each.counters.late ? "warn" : "faint"}`}>${count(each.counters.late)}</td>
      <td class="num">${count(each.kept)}</td></tr>`)}</tbody></table></div></section>`;
}

function Changes() {
  const [find, setFind] = useState(""), text = find.toLowerCase();
  const about = (each) => each.stream ?? each.transformation ?? each.unit ?? "";
  const list = changes.value.filter((each) => `${each.change} ${about(each)}`.toLowerCase().includes(text)).slice(-LISTED).reverse();
  return html`<section class="panel w5" aria-label="changes"><header><h2 class="grow">Changes</h2>
    <input type="search" class="short" placeholder="find" aria-label="find a change" value=${find}
      onInput=${(event) => setFind(event.target.value)} /></header>
    <div class="scroll cap" tabindex="0"><table><tbody>${list.map((each) => html`<tr key=${each.sequence}>
      <td class="faint num">${clock(each.time)}</td><td>${each.change}</td><td class="mono muted cut">${about(each)}</td></tr>`)}</tbody></table>
    ${!list.length && html`<${Empty} title="No changes."><span>New and removed streams, units and annotations appear here.</span><//>`}</div></section>`;
}

/** The answer to `path`, asked again and again. */
function usePolled(path, before) {
  const [found, setFound] = useState(before);
  useEffect(() => {
    const read = () => ask(path).then(setFound).catch(() => {});
    read();
    const timer = setInterval(read, POLL);
    return () => clearInterval(timer);
  }, [path]);
  return found;
}

const memory = html`<${Empty} title="All is in memory."><code>dyknow serve --data DIR</code><span>keeps it over a restart.</span><//>`;

function Journal() {
  const found = usePolled("/journal", null), { log, checkpoint } = found ?? {};
  return html`<section class="panel w5" aria-label="data directory"><header><h2>Data directory</h2></header>
    ${found && (!log ? memory : html`<div class="scroll cap" tabindex="0"><div class="body stack">
      ${found.failing.map((each) => html`<div class="note bad" key=${each}>${each}</div>`)}
      <dl class="facts"><dt>log</dt><dd>${bytes(log.bytes)} in ${plural(log.segments, "file")}</dd>
      <dt>commands</dt><dd>${count(log.first)} to ${count(log.last)}${log.waiting > 0 && `, ${count(log.waiting)} not on the disk yet`}</dd>
      <dt>checkpoint</dt><dd>${checkpoint ? `${bytes(checkpoint.bytes)}, ${duration(checkpoint.age)} ago` : "none yet"}</dd>
      <dt>a start replays</dt><dd>${plural(log.replayed, "command")}</dd>
      <dt>free on the disk</dt><dd>${bytes(found.free)}</dd></dl></div></div>`)}</section>`;
}

function Requests() {
  const list = usePolled(`/requests?status=${REFUSED}&limit=${LISTED}`, []);
  return html`<section class="panel w7" aria-label="refused requests"><header><h2 class="grow">Refused requests</h2>
      <span class="faint small">${list.length || ""}</span></header>
    <div class="scroll cap" tabindex="0">${list.length ? html`<table><tbody>${list.map((each) => html`<tr key=${each.id}>
        <td class="faint num">${clock(each.time)}</td><td class=${each.status >= FAILED ? "num bad" : "num warn"}>${each.status}</td>
        <td class="mono long">${each.method} ${each.path}</td><td class="muted">${each.problem?.split(":").at(-1).replaceAll("-", " ")}</td></tr>`)}</tbody></table>`
      : html`<${Empty} title="None."><span>Requests that the service refuses appear here, with the kind of problem.</span><//>`}</div></section>`;
}

/** Warnings and errors of the service's log, and the settings that are not the defaults. */
function Log() {
  const lines = usePolled("/log", []), settings = usePolled("/settings", []).filter((each) => !each.is_default);
  const tone = (level) => (level === "warning" ? "warn" : "bad");
  const said = (values) => Object.entries(values).map(([name, text]) => `${name}=${text}`).join(" ");
  return html`<section class="panel w7" aria-label="log"><header><h2 class="grow">Log</h2>
      <span class="faint small">warnings and errors</span></header>
    <div class="scroll cap" tabindex="0">${lines.length ? html`<table><tbody>${lines.map((each) => html`<tr key=${each.time + each.event}>
        <td class="faint num">${clock(each.time)}</td><td class=${tone(each.level)}>${each.event}</td><td class="long muted">${said(each.values)}</td></tr>`)}</tbody></table>`
      : html`<${Empty} title="No warnings."><span>Lines of the service's log from level warning on appear here.</span><//>`}</div></section>
    <section class="panel w5" aria-label="settings"><header><h2>Settings</h2></header>
    <div class="scroll cap" tabindex="0"><div class="body">${settings.length ? html`<dl class="facts">${settings.map((each) =>
        html`<dt class="mono">${each.name}</dt><dd class="mono">${each.value}</dd>`)}</dl>` : html`<span class="muted">All are the defaults.</span>`}</div></div></section>`;
}

/** What has been declared in KPL; nothing where nothing has. */
function Declarations() {
  const [text, setText] = useState("");
  useEffect(() => { ask("/kpl", { accept: "text/plain" }).then(setText).catch(() => {}); }, [changes.value.at(-1)?.sequence]);
  return text.trim() && html`<section class="panel w12" aria-label="declarations"><header><h2 class="grow">Declarations</h2>
    <span class="small faint">KPL</span></header><div class="scroll cap" tabindex="0"><pre class="wide-code">${text}</pre></div></section>`;
}

function Rate() {
  const past = history.value;
  const data = () => [past.map((each) => each.time), past.map((each) => each.in), past.map((each) => each.out)];
  return html`<section class="panel w7 rate" aria-label="rate"><header><h2 class="grow">Samples a second</h2>
    <span class="small"><span class="accent">in</span> <span class="faint">out, since this page is open</span></span></header>
    <${Plot} data=${data} tick=${past.at(-1)?.time} zero=${true} label="samples a second in and out" name="rates" /></section>`;
}

function Foot() {
  const [report, setReport] = useState(null);
  useEffect(() => { ask("/ontologies/report").then(setReport).catch(() => {}); }, []);
  return html`<section class="panel w12" aria-label="versions"><div class="foot small muted">
    <span>epoch <span class="mono">${status.value?.epoch}</span></span><span>${plural(units.value.length, "unit")}</span>
    <span>${plural(transformations.value.length, "transformation")}</span>
    <span>ontologies ${report ? (report.conforms ? "conform" : html`<b class="warn">do not conform: ${report.violations[0]?.message}</b>`) : "…"}</span>
    <span class="grow"></span><a href="/docs">HTTP interface</a><a href="/metrics">metrics</a>
    <a href="/specifications/current">configuration as XML</a></div></section>`;
}

export default function System() {
  theme.value;
  return html`<main class="page"><div class="system"><${Tiles} /><${Problems} /><${Rate} /><${Streams} /><${Changes} /><${Journal} />${may("admin") && html`<${Requests} /><${Log} />`}<${Declarations} /><${Foot} /></div></main>`;
}
