// A question of your own: SPARQL over the system and the ontologies, or a continuous query. The
// address holds the text, so that a question can be linked.
import { computed, html, useEffect, useMemo, useState } from "../vendor/preact.js";
import { PATTERN, asked, byName, makers, may, refresh, requests, units, vocabulary } from "../state.js";
import { address, ask, explain } from "../http.js";
import { end } from "../ending.js";
import { clock, duration, plural, shorten } from "../format.js";
import { Editor, parametersOf } from "../editor.js";
import { curve, layout } from "../layout.js";
import { PlanTree } from "../plan.js";
import { Empty, Trouble, download, say } from "../widgets.js";
import { QUESTIONS } from "../questions.js";

const ANSWERS = "application/sparql-results+json, application/ld+json;q=0.9";
const SHOWN = 1_000, NET = 300, EVERY = 1_000;
const resultsOf = (name) => `/queries/${encodeURIComponent(name)}/results`;
export const CONTINUOUS = [
  ["The highest altitude of each aircraft", "REGISTER QUERY highest COMPUTE EVERY 1s AS\nSELECT ?o (MAX(?a) AS ?top)\nWHERE { ?o a dyknow:Aircraft ; dyknow:altitude ?a }\nGROUP BY ?o\nWINDOW [RANGE 10s STEP 1s]"],
  ["The mean speed, as a new stream", "REGISTER STREAM means COMPUTE EVERY 5s AS\nCONSTRUCT { ?o dyknow:speed ?mean }\nWHERE { ?o a dyknow:Aircraft ; dyknow:speed ?v }\nAGGREGATE {(?mean, AVG, {?v})}\nWINDOW [RANGE 10s STEP 5s]"],
  ["Is one low?", "REGISTER QUERY low COMPUTE EVERY 1s AS\nASK { ?o a dyknow:Aircraft ; dyknow:altitude ?a FILTER (?a < 2000) }\nWINDOW [RANGE 5s STEP 1s]"],
  ["Above 3,000 ft within 20 s, as a formula", "monitor brief(?x in Aircraft) =\n  altitude(?x) < 3000 [ft] -> eventually [0s, 20s] altitude(?x) >= 3000 [ft]"],
  ["A climb of 1,000 ft within a minute, as a pattern", "REGISTER STREAM climb AS\nPATTERN SEQ(altitude a, altitude b)\nWHERE skip_till_next_match [id] AND b.value - a.value > 1000 [ft]\nWITHIN 1 minute\nRETURN a.id AS object, a.value AS low, b.value AS high"],
];
const FIRST = QUESTIONS[0][1].join("");

/** Streams of this system for those of the questions' example: `out` is made of `gps` and others,
    `both` of two. */
const example = computed(() => {
  const read = new Set(units.value.flatMap((unit) => unit.inputs));
  const out = units.value.findLast((unit) => !read.has(unit.output))?.output;
  let gps = out;
  while (makers.value.has(gps)) [gps] = makers.value.get(gps).inputs;
  return { gps, out, both: units.value.find((unit) => unit.inputs.length > 1)?.output ?? out };
});

/** A name that SPARQL takes behind a colon as it is. */
const SIMPLE = /^[A-Za-z]\w*$/;

/** The questions about this system; those about streams that it has not are left out. Every second
    part of a text is a name of the questions' example. */
const questions = computed(() => QUESTIONS.flatMap(([title, code]) => {
  const own = (text) => text.map((part, i) => (i % 2 ? example.value[part] : part)).join("");
  const names = code.filter((_, i) => i % 2).map((name) => example.value[name] ?? "");
  return names.every((name) => SIMPLE.test(name)) ? [[own(title), own(code)]] : [];
}));

/** An IRI in short; names of the stream space as the questions write them, `:hasName`. */
function short(iri) {
  const { "dyknow-o": space, ...others } = vocabulary.value.prefixes;
  return shorten(iri, space ? { "": space, ...others } : others);
}

/** JSON-LD without context as triples [subject, predicate, object]; objects are terms. */
function triplesOf(nodes) {
  return nodes.flatMap((node) => Object.entries(node).flatMap(([key, values]) => {
    if (key === "@id") return [];
    const predicate = key === "@type" ? `${vocabulary.value.prefixes.rdf}type` : key;
    return values.map((each) => [node["@id"], predicate,
      typeof each === "string" ? { type: "uri", value: each }
        : "@id" in each ? { type: "uri", value: each["@id"] } : { type: "literal", value: String(each["@value"]) }]);
  }));
}

/** An answer of /sparql or of a query's results, as the page draws it. */
function shaped(found) {
  if (Array.isArray(found)) return { triples: triplesOf(found) };
  if (found.boolean !== undefined) return { truth: found.boolean };
  return { names: found.head.vars, rows: found.results.bindings };
}

function Term({ of }) {
  if (!of) return html`<span class="faint">–</span>`;
  if (of.type !== "literal") return html`<span class="mono" title=${of.value}>${short(of.value)}</span>`;
  return byName.value.has(of.value) ? html`<a class="mono" href=${`#graph/${encodeURIComponent(of.value)}`}>${of.value}</a>` : of.value;
}

const isNumber = (term) => term?.datatype && ["integer", "decimal", "double", "float"].some((each) => term.datatype.endsWith(`#${each}`));

function Table({ names, rows }) {
  const [order, setOrder] = useState(null);
  const sorted = useMemo(() => {
    if (!order) return rows;
    const [name, way] = order;
    const key = (row) => (isNumber(row[name]) ? Number(row[name].value) : row[name]?.value ?? "");
    return [...rows].sort((a, b) => (key(a) < key(b) ? -way : key(a) > key(b) ? way : 0));
  }, [rows, order]);
  const turn = (name) => setOrder([name, order?.[0] === name ? -order[1] : 1]);
  const mark = (name) => (order?.[0] !== name ? "" : order[1] > 0 ? " ↑" : " ↓");
  return html`<table><thead><tr>${names.map((name) => html`<th key=${name} class=${rows.some((row) => isNumber(row[name])) ? "num" : ""}><button class="plain" onClick=${() => turn(name)}>${name}${mark(name)}</button></th>`)}</tr></thead>
    <tbody>${sorted.slice(0, SHOWN).map((row) => html`<tr>${names.map((name) => html`<td class=${isNumber(row[name]) ? "num" : "long"}><${Term} of=${row[name]} /></td>`)}</tr>`)}</tbody></table>
    ${rows.length > SHOWN && html`<div class="body faint small">The first ${SHOWN} of ${rows.length}; the download has all.</div>`}`;
}

function Net({ triples }) {
  const drawn = useMemo(() => {
    const names = [...new Set(triples.flatMap(([s, , o]) => [s, o.value]))].slice(0, NET), known = new Set(names);
    const kept = triples.filter(([s, , o]) => known.has(s) && known.has(o.value));
    const text = (id) => (short(id).length > 34 ? `${short(id).slice(0, 33)}…` : short(id));
    const nodes = names.map((id) => ({ id, text: text(id), w: 24 + 7 * text(id).length, h: 28 }));
    return { nodes, kept, ...layout(nodes, kept.map(([s, , o]) => [s, o.value]), { layerGap: 120 }) };
  }, [triples]);
  const box = `-10 -10 ${drawn.width + 20} ${drawn.height + 20}`;
  return html`<svg class="resultnet" viewBox=${box} style=${{ maxWidth: `${drawn.width + 20}px` }} role="img" aria-label="graph of the result">
    ${drawn.kept.map(([, verb], i) => {
      const points = drawn.paths[i];
      if (points.length < 2) return null;
      const [x, y] = [0, 1].map((k) => (points[0][k] + points[1][k]) / 2);
      return html`<path class="edge" d=${curve(points)} /><text class="verb" x=${x} y=${y - 4} text-anchor="middle">${short(verb)}</text>`;
    })}
    ${drawn.nodes.map((node) => {
      const at = drawn.places.get(node.id);
      return html`<g class="node" transform=${`translate(${at.x} ${at.y - 14})`}><rect width=${node.w} height="28" rx="6" />
        <text x=${node.w / 2} y="18" text-anchor="middle">${node.text}</text></g>`;
    })}</svg>`;
}

function Result({ result, view }) {
  if (result.truth !== undefined) return html`<div class="body"><h3>${result.truth ? "Yes" : "No"}</h3></div>`;
  if (result.stages) {
    return html`<div class="body stack">${result.plan.length > 0 && html`<${PlanTree} goal=${result.found ? "There is a plan" : "Nothing answers this yet"} plan=${result.plan} />`}
      ${result.stages.map((stage) => html`<details key=${stage.title} open=${stage.title === "evaluation"}><summary>${stage.title}</summary><pre class="wide-code" tabindex="0">${stage.text}</pre></details>`)}</div>`;
  }
  if (result.rows?.length === 0 || result.triples?.length === 0) {
    return html`<${Empty} title="No rows."><span>The query is right, and nothing fits it.</span><//>`;
  }
  if (result.rows) return html`<${Table} names=${result.names} rows=${result.rows} />`;
  if (view === "graph") return html`<div class="body"><${Net} triples=${result.triples} /></div>`;
  const uri = (value) => ({ type: "uri", value });
  const rows = result.triples.map(([s, p, o]) => ({ subject: uri(s), predicate: uri(p), object: o }));
  return html`<${Table} names=${["subject", "predicate", "object"]} rows=${rows} />`;
}

function Questions({ isContinuous, text, pick, watched, watch }) {
  const [find, setFind] = useState("");
  const running = requests.value.filter((each) => each.kind === "query");
  const list = isContinuous ? CONTINUOUS : questions.value.filter(([title]) => title.toLowerCase().includes(find.toLowerCase()));
  const go = (where) => () => { location.hash = where; };
  return html`<section class="panel list" aria-label="questions"><header><h2 class="hidden">Questions</h2><div class="tabs" role="group" aria-label="kind">
      <button aria-pressed=${!isContinuous} onClick=${go("query")}>Once</button>
      <button aria-pressed=${isContinuous} onClick=${go("query/continuous")}>Continuous</button></div></header>
    <div class="scroll" tabindex="0">
      ${isContinuous ? html`<h3 class="group">Running</h3>
        ${running.map((each) => html`<button class="item" key=${each.id} aria-pressed=${watched === each.id} onClick=${() => watch(each)}>
          <span class="row"><i class=${`dot ${each.state === "running" ? "on" : "bad"}`}></i><span class="grow mono">${each.name}</span><span class="faint">${each.chips[0]}</span></span></button>`)}
        ${!running.length && html`<div class="body faint small">None. Register one; its results are a stream of its name.</div>`}
        <h3 class="group">Examples</h3>`
      : html`<div class="body"><input type="search" placeholder="find a question" aria-label="find a question" value=${find} onInput=${(event) => setFind(event.target.value)} /></div>`}
      ${list.map(([title, code]) => html`<button class="item" key=${title} aria-pressed=${text === code} onClick=${() => pick(code)}>${title}</button>`)}
      ${isContinuous && html`<div class="body small muted">Without FROM STREAM a query names features only, and streams are found or built for them. Formulas and patterns run here, too.</div>`}</div></section>`;
}

const TERM = /^(<.*>|".*"\S*|'.*'\S*|[+-]?[\d.]+([eE][+-]?\d+)?|true|false|([A-Za-z]\w*)?:\S*)$/;
/** What a field holds as a term: numbers, IRIs and names in short stay as they are, all else is a text. */
const term = (text) => (TERM.test(text) ? text : JSON.stringify(text));

/** A field for each parameter of the question. An empty one leaves its variable free. */
function Parameters({ of, given, give, run }) {
  return html`<div class="parameters">${of.map((name) => html`<label key=${name}><span class="mono">$${name}</span>
    <input type="text" placeholder="any" title="a text, 100, dyknow:UAV, <iri>" value=${given[name] ?? ""}
      onInput=${(event) => give({ ...given, [name]: event.target.value })}
      onKeyDown=${(event) => event.key === "Enter" && run()} />
    ${given[name] && !TERM.test(given[name].trim()) && html`<span class="faint">a text; a name has its prefix, as dyknow:speed</span>`}</label>`)}</div>`;
}

/** What completes in the editor: the names of the ontology. */
const names = () => [
  ...vocabulary.value.features.map((each) => ({ label: each.name, detail: each.unit ?? "feature" })),
  ...vocabulary.value.sorts.map((each) => ({ label: each.name, detail: "sort" })),
];

export default function Query({ rest }) {
  const isContinuous = rest.startsWith("continuous"), kept = rest.slice(rest.indexOf("/") + 1 || rest.length);
  const first = kept || (isContinuous ? CONTINUOUS[0][1] : FIRST);
  const terms = rest.startsWith("once?") ? rest.slice("once?".length, rest.indexOf("/")) : "";
  const [text, write] = useState(first), [result, show] = useState(null), [trouble, fail] = useState(null);
  const [isBusy, setBusy] = useState(false), [view, setView] = useState("graph"), [watched, watch] = useState(null);
  const [given, give] = useState({});
  const parameters = isContinuous ? [] : parametersOf(text);
  const filled = Object.fromEntries(parameters.filter((name) => given[name]).map((name) => [name, given[name]]));
  const reset = (code, query) => {
    write(code);
    show(null);
    fail(null);
    watch(query ?? null);
  };
  useEffect(() => {
    if (text !== first) reset(first);
  }, [first]);
  useEffect(() => give(Object.fromEntries(new URLSearchParams(terms))), [terms]);
  const keep = () => {
    const kind = isContinuous ? "continuous" : address("once", filled);
    history.replaceState(null, "", `#query/${encodeURIComponent(kind)}/${encodeURIComponent(text)}`);
  };
  const once = (accept) => {
    const terms = Object.fromEntries(Object.entries(filled).map(([name, each]) => [`$${name}`, term(each.trim())]));
    return ask(address("/sparql", terms), { method: "POST", type: "application/sparql-query", body: text, accept });
  };
  const attempt = async (work) => {
    setBusy(true);
    try {
      await work();
      fail(null);
    } catch (error) {
      fail(error);
      show(null);
    }
    setBusy(false);
  };
  const run = () => attempt(async () => {
    const begun = performance.now();
    keep();
    watch(null);
    const found = isContinuous ? await explain({ query: text })
      : shaped(await once(ANSWERS));
    show({ ...found, took: (performance.now() - begun) / 1000 });
  });
  const register = () => attempt(async () => {
    keep();
    const made = await ask("/queries?since=start", { method: "POST", type: "text/plain", body: text });
    say(`${made.name} runs`);
    show(null);
    watch(made.name);
    refresh();
  });
  const save = () => attempt(async () => {
    const [accept, ending] = result.triples ? ["application/n-triples", "nt"] : ["text/csv", "csv"];
    const content = watched ? await ask(resultsOf(watched), { accept }) : await once(accept);
    download(`${watched ?? "result"}.${ending}`, content);
  });
  const stop = () => attempt(async () => {
    await end(requests.value.find((each) => each.kind === "query" && each.id === watched));
    watch(null);
    show(null);
  });
  useEffect(() => {
    if (!watched) return undefined;
    let due = 0, isOver = false;
    const next = async () => {
      try {
        const found = await ask(resultsOf(watched), { accept: ANSWERS });
        if (!isOver) show(shaped(found));
      } catch (error) {
        if (isOver) return;
        if (error.status === 406) return show({ isLive: true });
        if (error.status !== 404) return fail(error);
      }
      if (!isOver) due = setTimeout(next, EVERY);
    };
    next();
    return () => {
      isOver = true;
      clearTimeout(due);
    };
  }, [watched]);
  const number = result?.rows?.length ?? result?.triples?.length;
  const heading = watched ? html`Last window of <span class="mono">${watched}</span>` : isContinuous ? "Explanation" : "Result";
  return html`<main class="page fill"><div class="query">
    <${Questions} isContinuous=${isContinuous} text=${text} pick=${reset} watched=${watched} watch=${(each) => reset(each.source, each.id)} />
    <section class="panel editor" aria-label="text"><header><h2 class="grow">${isContinuous ? "Continuous query" : "SPARQL 1.1"}</h2>
      <span class="faint small wide"><kbd>Ctrl ⏎</kbd></span>
      ${isContinuous ? html`<button onClick=${run} disabled=${isBusy}>Explain</button>
        ${may("admin") && html`<button class="main" onClick=${register} disabled=${isBusy}>Register</button>`}`
      : html`<button class="main" onClick=${run} disabled=${isBusy}>Run</button>`}</header>
      <${Editor} text=${text} change=${write} run=${run} complete=${names()} problem=${trouble} label=${isContinuous ? "continuous query" : "SPARQL query"} />
      ${parameters.length > 0 && html`<${Parameters} of=${parameters} given=${given} give=${give} run=${run} />`}</section>
    <section class="panel result" aria-label="result"><header><h2 class="grow cut">${heading}</h2>
      ${number != null && html`<span class="small faint num">${plural(number, result.triples ? "triple" : "row")}${result.took ? `, ${duration(result.took)}` : `, ${clock(Date.now())}`}</span>`}
      ${result?.triples && html`<div class="tabs" role="group" aria-label="view">${["graph", "triples"].map((each) =>
        html`<button aria-pressed=${view === each} onClick=${() => setView(each)}>${each}</button>`)}</div>`}
      ${number > 0 && html`<button onClick=${save}>${result.triples ? "N-Triples" : "CSV"}</button>`}
      ${watched && html`<a class="small" href=${`#live/${encodeURIComponent(watched)}`}>Follow</a>${may("admin") && html`<button class="danger" onClick=${stop}>End it</button>`}`}</header>
      <div class="scroll" tabindex="0">${trouble ? html`<div class="body"><${Trouble} of=${trouble} /></div>`
        : result?.isLive ? html`<${Empty} title=${asked.value.get(watched)?.gives === PATTERN ? "It reports matches." : "It reports verdicts."}><a href=${`#live/${encodeURIComponent(watched)}`}>Follow them</a><//>`
        : result ? html`<${Result} result=${result} view=${view} />`
        : html`<${Empty} title=${watched ? "No window has closed yet." : isContinuous ? "Explain before you register." : "Ask the system about itself."}>
          <span>${watched ? "A window closes when its streams have passed its end." : isContinuous
            ? "The explanation shows which streams it would read, how it is evaluated and the cost of a window."
            : "Ontologies, templates, streams and units are one graph. Choose a question, change it, run it."}</span><//>`}</div></section>
  </div></main>`;
}
