// Streams and the units that make them, from left to right. Choose one: what it is, what feeds it,
// and what breaks without it.
import { html, useEffect, useMemo, useRef, useState } from "../vendor/preact.js";
import { byName, held, numbers, objectField, problems, requests, silence, status, streams, title, transformations, unitOf, units } from "../state.js";
import { chain, model, reached } from "../graph.js";
import { curve, layout } from "../layout.js";
import { drawShape, nodeAt } from "../shape.js";
import { address, ask, follow } from "../http.js";
import { ago, clock, count, duration, rate, value } from "../format.js";
import { Partial } from "../partial.js";
import { Chips, Empty, Plot, Trouble, aligned, theme } from "../widgets.js";

const MANY = 150, MOST_BOXES = 3_000, SILENT = 15, FIELDS = 6, LINES = 12, KEPT = 600, TAIL = 30, FAR = 0.45;
const path = (name) => `#graph/${encodeURIComponent(name)}`;
const pen = new OffscreenCanvas(1, 1).getContext("2d");

/** `text` cut to `room` pixels. */
function fit(text, room, font) {
  pen.font = font;
  if (pen.measureText(text).width <= room) return text;
  let end = text.length;
  while (end > 0 && pen.measureText(`${text.slice(0, end)}…`).width > room) end--;
  return `${text.slice(0, end)}…`;
}

/** The two lines of a node: what it means, and how it is. */
function lines(node, apart) {
  if (node.kind === "unit") return [node.unit.transformation, ""];
  if (node.kind === "stack") return [`${node.unit.transformation} × ${node.stack.length}`, "folded: they read the same"];
  const stream = byName.value.get(node.stream);
  if (!stream) return [node.stream, ""];
  const asked = node.requests[0], more = node.requests.length > 1 ? ` × ${node.requests.length}` : "";
  const quiet = silence(stream);
  const state = stream.ended ? "ended" : quiet === null ? "no sample yet" : quiet > SILENT ? `silent ${duration(quiet)}` : rate(stream.rate);
  const by = node.unit && !apart ? node.unit.transformation : stream.name;
  return [asked ? asked.name + more : title(stream), `${state} · ${by}`];
}

/** What of a drawing an element shows; `apply` is called when that has changed. */
class View {
  auto = true;
  x = 20; y = 20; scale = 1;

  constructor(element, apply) {
    this.element = element;
    this.apply = () => apply(this);
  }

  fit(drawn, number, chosen) {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !number) return;
    const whole = Math.min(1.1, (width - 40) / drawn.width, (height - 40) / drawn.height);
    // Texts stay legible: a larger graph begins at its top and left.
    this.scale = number > MOST_BOXES ? whole : Math.max(number < 120 ? 0.72 : 0.5, whole);
    this.x = Math.max(16, (width - drawn.width * this.scale) / 2);
    this.y = Math.max(16, (height - drawn.height * this.scale) / 2);
    const at = drawn.places.get(chosen);
    if (at && (this.scale < FAR || drawn.width * this.scale > width)) {
      this.scale = Math.max(this.scale, 0.8);
      this.x = width / 2 - (at.x + at.w / 2) * this.scale;
      this.y = height / 2 - at.y * this.scale;
    }
    this.apply();
  }

  zoom(factor, x, y) {
    const scale = Math.min(3, Math.max(0.003, this.scale * factor));
    this.x = x - ((x - this.x) * scale) / this.scale;
    this.y = y - ((y - this.y) * scale) / this.scale;
    this.scale = scale;
    this.auto = false;
    this.apply();
  }

  listen() {
    let from = null;
    this.element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    this.element.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      this.isDragged = false;
    });
    this.element.addEventListener("pointermove", (event) => {
      if (!from || !event.buttons) return;
      this.x += event.clientX - from[0];
      this.y += event.clientY - from[1];
      from = [event.clientX, event.clientY];
      this.auto = false;
      this.isDragged = true;
      this.apply();
    });
  }
}

function Node({ node, at, isChosen, isDim, level, apart, pick, keys }) {
  const [one, two] = lines(node, apart);
  const classes = ["node", node.kind, node.requests.length && "request", level, isChosen && "chosen", isDim && "dim"];
  return html`<g class=${classes.filter(Boolean).join(" ")} data-id=${node.id} transform=${`translate(${at.x} ${at.y - node.h / 2})`}
    tabindex="0" role="button" aria-pressed=${isChosen}
    onClick=${() => pick(node)} onKeyDown=${(event) => keys(event, node)}>
    <title>${`${node.stream ?? node.unit.name}: ${one}`}</title>
    <rect width=${node.w} height=${node.h} rx=${node.kind === "unit" ? node.h / 2 : 6} />
    ${level && html`<circle class="state" cx=${node.w - 12} cy="14" r="3.5" />`}
    <text x="12" y=${two ? 18 : node.h / 2 + 4}>${fit(one, node.w - 30, "12px Inter")}</text>
    ${two && html`<text class="second" x="12" y="34">${fit(two, node.w - 20, "11px Inter")}</text>`}</g>`;
}

/** Panning and zooming move one group, so that nothing is drawn again. */
function moveGroup({ element, x, y, scale }) {
  element.firstElementChild.setAttribute("transform", `translate(${x} ${y}) scale(${scale})`);
  element.classList.toggle("far", scale < FAR);
}

function Sheet({ graph, chosen, pick, hits, apart }) {
  const sheet = useRef(), view = useRef(), draw = useRef();
  const drawn = useMemo(() => layout(graph.nodes, graph.edges), [graph]);
  const isShape = graph.nodes.length > MOST_BOXES;
  draw.current = isShape ? (of) => drawShape(of.element, of, graph, drawn, hits) : moveGroup;
  const lit = useMemo(() => (graph.nodes.some((node) => node.id === chosen) ? chain(chosen, graph.edges) : null), [graph, chosen]);
  const whole = () => view.current.fit(drawn, graph.nodes.length, chosen);
  useEffect(() => {
    view.current = new View(sheet.current, (of) => draw.current(of));
    view.current.listen();
  }, [isShape]);
  useEffect(() => {
    const show = () => (view.current.auto ? whole() : view.current.apply());
    show();
    const watch = new ResizeObserver(show);
    watch.observe(sheet.current);
    return () => watch.disconnect();
  }, [drawn]);
  useEffect(() => view.current.apply(), [hits, theme.value]);
  const keys = (event, node) => {
    const side = { ArrowRight: 1, ArrowLeft: 0 }[event.key];
    const edge = side === undefined ? null : graph.edges.find((each) => each[1 - side] === node.id);
    const next = edge && graph.nodes.find((each) => each.id === edge[side]);
    if (event.key === "Enter" || event.key === " ") pick(node);
    else if (next) {
      pick(next);
      sheet.current.querySelector(`[data-id="${CSS.escape(next.id)}"]`)?.focus();
    } else return;
    event.preventDefault();
  };
  const isDim = (id) => (hits ? !hits.has(id) : lit !== null && !lit.has(id));
  const levels = new Map(problems.value.map((each) => [each.stream, each.level]));
  const edgeClass = ([from, to]) => (lit?.has(from) && lit.has(to) ? "edge on" : isDim(from) || isDim(to) ? "edge dim" : "edge");
  const thick = (stream) => 1 + Math.min(4, Math.log10(1 + (byName.value.get(stream)?.rate ?? 0)));
  const empty = status.value && !graph.nodes.length && html`<${Empty} title="No streams yet."><span>Publish one:</span><code>dyknow replay flights.csv --stream flights</code><//>`;
  const over = html`<div class="over"><button onClick=${() => { view.current.auto = true; whole(); }}>Fit</button></div>`;
  if (isShape) {
    const choose = (event) => {
      const node = nodeAt(view.current, graph, drawn, event.offsetX, event.offsetY);
      if (node && !view.current.isDragged) pick(node);
    };
    return html`<div class="sheet"><canvas key="shape" class="net" ref=${sheet} role="img" onClick=${choose}
      aria-label=${`${graph.nodes.length} streams, too many for boxes: find one by its name, or choose a request`}></canvas>${over}</div>`;
  }
  return html`<div class="sheet"><svg key="boxes" class="net" ref=${sheet} role="group" aria-label="stream graph"><g>
    ${graph.edges.map((edge, i) => drawn.paths[i].length > 1 && html`<path key=${edge.join()} class=${edgeClass(edge)} d=${curve(drawn.paths[i])} stroke-width=${thick(edge[2])} />`)}
    ${graph.nodes.map((node) => html`<${Node} key=${node.id} node=${node} at=${drawn.places.get(node.id)} isChosen=${node.id === chosen}
      isDim=${isDim(node.id)} level=${levels.get(node.stream)} apart=${apart} pick=${pick} keys=${keys} />`)}</g></svg>
    ${empty}${over}</div>`;
}

/** The last samples of a stream, and those that arrive. */
function useTail({ name, ended }) {
  const [rows, setRows] = useState([]), [trouble, setTrouble] = useState(null);
  useEffect(() => {
    const kept = [];
    let due = 0, isOver = false;
    const show = () => { due ||= setTimeout(() => { due = 0; if (!held.value && !isOver) setRows(kept.slice(-KEPT)); }, 250); };
    setRows([]);
    setTrouble(null);
    const base = `/streams/${encodeURIComponent(name)}`;
    const stop = follow(address(`${base}/events`, { last: 200, rdf: "no" }), (messages) => {
      for (const each of messages) if (each.event === "sample") kept.push({ available: each.available, valid: each.valid, ...each.values });
      if (kept.length > 1.5 * KEPT) kept.splice(0, kept.length - KEPT);
      show();
    }, (state, error) => { if (state === "failed" && !isOver) setTrouble(error); });
    return () => {
      isOver = true;
      stop();
      clearTimeout(due);
    };
  }, [name, ended]);
  return [rows, trouble];
}

function Tail({ stream }) {
  const [rows, trouble] = useTail(stream), [wished, setField] = useState(null);
  const id = objectField(stream), plottable = numbers(stream), field = plottable.includes(wished) ? wished : plottable[0];
  const groups = [...Map.groupBy(rows, (row) => row[id])].sort((a, b) => b[1].length - a[1].length).slice(0, LINES);
  const data = () => aligned(groups.map(([, group]) => group.map((row) => [Date.parse(row.valid) / 1000, row[field]])));
  const names = id ? groups.map(([name]) => String(name)) : [];
  const shown = stream.fields.slice(0, FIELDS), isNumber = (each) => plottable.includes(each.name);
  return html`<${Trouble} of=${trouble} />
    ${plottable.length > 0 && html`<div class="body"><div class="row"><h3 class="grow">Last samples</h3>
      <select aria-label="field" value=${field} onChange=${(event) => setField(event.target.value)}>${plottable.map((each) => html`<option value=${each}>${each} ${unitOf(stream, each)}</option>`)}</select></div>
      <div class="smallplot"><${Plot} data=${data} tick=${`${rows.length}${rows.at(-1)?.valid}${field}`} label=${`${field} over time`} names=${names} name=${`${stream.name}-${field}`} /></div></div>`}
    <table><thead><tr><th>valid</th>${shown.map((each) => html`<th class=${isNumber(each) ? "num" : ""}>${each.name}</th>`)}</tr></thead>
      <tbody>${rows.slice(-TAIL).reverse().map((row) => html`<tr><td class="faint num">${clock(row.valid)}</td>
        ${shown.map((each) => html`<td class=${isNumber(each) ? "num" : "mono cut"}>${value(row[each.name])}</td>`)}</tr>`)}</tbody></table>`;
}

function Why({ request }) {
  const [found, setFound] = useState(null);
  useEffect(() => {
    setFound(null);
    if (request.kind !== "subscription") ask(address("/explain", { id: request.id })).then(setFound).catch(() => {});
  }, [request.id]);
  return found?.stages.map((stage) => html`<details key=${stage.title}><summary>${stage.title}</summary><pre class="wide-code" tabindex="0">${stage.text}</pre></details>`);
}

function Details({ node, graph, pick }) {
  const unit = node?.unit, stream = byName.value.get(node?.stream), request = node?.requests[0];
  if (!node) {
    return html`<aside class="panel" aria-label="details"><${Empty} title="Choose a box.">
      <span>It shows what the stream means, what feeds it, what breaks without it, and its last samples.</span>
      <span>A box is a stream with the transformation that makes it, blue where a request reads it. A line is as thick as its stream is fast. Amber and red mark problems.</span><//></aside>`;
  }
  const link = (id) => html`<a class="mono" href=${path(id)}>${id}</a> `;
  const near = (side, none) => {
    const found = [...reached(node.id, graph.edges, side)].filter((id) => byName.value.has(id));
    return found.length ? found.map(link) : html`<span class="faint">${none}</span>`;
  };
  const made = transformations.value.find((each) => each.name === unit?.transformation);
  const parameters = unit ? Object.entries(unit.parameters).filter(([, text]) => !text.includes("\n")) : [];
  return html`<aside class="panel" aria-label="details"><header><h2 class="grow cut">${lines(node, false)[0]}</h2>
      <button class="plain" aria-label="close" onClick=${() => pick(null)}>✕</button></header>
    <div class="scroll" tabindex="0"><div class="body stack">
      ${problems.value.filter((each) => each.stream && each.stream === node.stream).map((each) => html`<div class=${`note ${each.level}`} key=${each.what}><b>${each.what}.</b> ${each.detail} ${each.hint}</div>`)}
      ${request && html`<div class="row"><span class="grow"><${Chips} of=${request.chips} /></span><${Partial} key=${request.id} request=${request} /><a class="small" href=${`#live/${encodeURIComponent(node.stream)}`}>Its events</a></div>`}
      <dl class="facts">
        ${stream && html`<dt>stream</dt><dd class="mono">${stream.name}</dd>`}
        ${unit && html`<dt>made by</dt><dd>${unit.transformation} <span class="faint mono">${unit.name}</span></dd>`}
        ${made && html`<dt>which is</dt><dd>${made.text}</dd>`}
        ${parameters.map(([name, text]) => html`<dt>${name}</dt><dd class="mono">${text}</dd>`)}
        ${unit && html`<dt>work</dt><dd>${duration(unit.busy)}${unit.windows ? `, ${count(unit.windows)} windows` : ""}${unit.lag ? `, ${duration(unit.lag)} behind` : ""}</dd>`}
        ${unit && (unit.errors > 0 || unit.overruns > 0 || unit.late > 0) && html`<dt>lost</dt><dd class="warn">${count(unit.errors)} errors, ${count(unit.overruns)} windows, ${count(unit.late)} late</dd>`}
        ${stream && html`<dt>rate</dt><dd>${stream.ended ? "ended" : rate(stream.rate)}, ${count(stream.counters.accepted)} in all</dd>
          <dt>last sample</dt><dd>${silence(stream) === null ? "none yet" : ago(silence(stream))}</dd>
          <dt>late, twice</dt><dd>${count(stream.counters.late)}, ${count(stream.counters.duplicate)}</dd>
          <dt>kept</dt><dd>${count(stream.kept)} of ${count(stream.retention.samples)}</dd><dt>readers</dt><dd>${stream.subscribers}</dd>`}
        <dt>comes from</dt><dd>${near(0, "outside")}</dd><dt>feeds</dt><dd>${near(1, "no other stream")}</dd></dl>
      ${stream?.annotation && html`<div><h3>Meaning</h3><pre class="code">${stream.annotation}</pre></div>`}
      ${stream && !stream.annotation && html`<div class="note">It has no annotation, so matching does not know what it means.
        <code>dyknow annotate 'stream ${stream.name} contains …'</code></div>`}
      ${request && html`<div><${Why} key=${request.id} request=${request} /></div>`}</div>
      ${stream && html`<${Tail} key=${stream.name} stream=${stream} />`}</div></aside>`;
}

export default function Graph({ rest }) {
  const [only, setOnly] = useState(""), [fold, setFold] = useState(true), [apart, setApart] = useState(false), [find, setFind] = useState("");
  const [chosen, setChosen] = useState(rest || null);
  theme.value;
  useEffect(() => setChosen(rest || null), [rest]);
  // A large system is read chain by chain.
  const focus = only || (streams.value.length > MANY ? chosen : null);
  const shape = JSON.stringify([streams.value.map((each) => each.name), units.value.map((each) => [each.name, each.inputs]), requests.value.map((each) => [each.id, each.stream]), focus, fold, apart]);
  const graph = useMemo(() => model(streams.value, units.value, requests.value, { only: focus, fold: fold && !focus, apart }), [shape]);
  const pick = (node) => {
    setChosen(node?.id ?? null);
    history.replaceState(null, "", node?.stream ? path(node.stream) : "#graph");
  };
  const text = find.toLowerCase();
  const about = (node) => `${node.id} ${node.unit?.transformation ?? ""} ${node.requests.map((each) => each.name).join(" ")} ${byName.value.get(node.stream)?.annotation ?? ""}`;
  const hits = text ? new Set(graph.nodes.filter((node) => about(node).toLowerCase().includes(text)).map((node) => node.id)) : null;
  // A node that the graph shows with another's data: the present one, since counters change.
  const node = graph.nodes.find((each) => each.id === chosen);
  const current = node && { ...node, unit: units.value.find((each) => each.name === node.unit?.name) };
  const box = (label, isOn, set) => html`<label class="row small muted wide"><input type="checkbox" checked=${isOn} onChange=${(event) => set(event.target.checked)} />${label}</label>`;
  return html`<main class="page fill"><div class="graph"><section class="panel net-panel" aria-label="graph"><header>
      <input type="search" class="find" placeholder="name or meaning" aria-label="find" value=${find} onInput=${(event) => setFind(event.target.value)} />
      <select aria-label="show" value=${only} onChange=${(event) => setOnly(event.target.value)}><option value="">everything</option>
        ${requests.value.map((each) => html`<option key=${each.id} value=${each.stream}>${[each.name, ...each.chips].join(" ")}</option>`)}</select>
      <span class="grow"></span><span class="small faint num wide">${graph.nodes.length === 1 ? "1 box" : `${graph.nodes.length} boxes`}</span>
      ${box("units apart", apart, setApart)}${box("fold alike", fold, setFold)}</header>
    <${Sheet} graph=${graph} chosen=${chosen} pick=${pick} hits=${hits} apart=${apart} /></section>
    <${Details} node=${current} graph=${graph} pick=${pick} /></div></main>`;
}
