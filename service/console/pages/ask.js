// Say what you want to know: a template, its arguments, the plan that would answer it, and why.
// Nothing starts before Start.
import { html, useEffect, useState } from "../vendor/preact.js";
import { byName, isKnown, may, refresh, requests, templates, vocabulary } from "../state.js";
import { shown, tick } from "../feed.js";
import { local, plural, rate, stamp, unit, value, words } from "../format.js";
import { ask, explain } from "../http.js";
import { eventText, initial, prefixed, sorts, term, usual } from "../terms.js";
import { PlanTree } from "../plan.js";
import { Chips, Empty, Trouble, say } from "../widgets.js";

const WAIT = 250;
const STRATEGIES = {
  fast: "the first plan that is found", cost: "the cheapest plan",
  quality: "the plan of the best quality", "weighted:cost=1,quality=10": "cost against quality",
};
const COMPARED = { ">": "above", ">=": "from", "<": "below", "<=": "up to", "=": "equal to", "!=": "other than" };
const AGGREGATES = { AVG: "mean", MAX: "greatest", MIN: "least", SUM: "sum of", COUNT: "number of", SAMPLE: "any" };
const LABELS = { object: "object", sort: "of sort", feature: "feature", number: "number", text: "text",
  duration: "duration" };
const SINCE = { now: "now", start: "with what is kept" };

const Choice = ({ id, current, options, choose }) => html`<select id=${id} value=${current}
  onChange=${(event) => choose(event.target.value)}>${Object.entries(options).map(([key, text]) =>
    html`<option value=${key} selected=${key === current}>${text}</option>`)}</select>`;
const named = (list) => Object.fromEntries(list.map((each) => [each, each]));

function Argument({ use, text, write }) {
  const id = `p-${use.name.slice(1)}`;
  const label = use.comparison ? COMPARED[use.comparison] : LABELS[use.role];
  const options = use.role === "sort" ? named(sorts())
    : use.role === "feature" ? named(vocabulary.value.features.map((each) => local(each.name))) : null;
  const help = use.role === "object" ? "empty: every one"
    : use.feature ? `${AGGREGATES[use.aggregate] ?? ""} ${local(use.feature)}` : "";
  const isDefault = text === initial(use), usual = initial(use) || "any";
  const notes = [help, use.default !== null && (isDefault ? "the default" : `default ${usual}`)].filter(Boolean);
  return html`<div class="field"><label for=${id}>${label}</label>
    ${options ? html`<${Choice} id=${id} current=${text} options=${options} choose=${write} />`
      : html`<span class="row"><input id=${id} type=${use.role === "number" ? "number" : "text"} step="any"
          placeholder=${use.role === "object" ? "any" : ""} value=${text} onInput=${(event) => write(event.target.value)} />
          ${use.unit && html`<span class="faint">${unit(use.unit)}</span>`}</span>`}
    <small>${notes.join(", ")}</small></div>`;
}

function FeatureForm({ want, setWant }) {
  const feature = vocabulary.value.features.find((each) => local(each.name) === want.feature);
  const set = (name) => (text) => setWant({ ...want, [name]: text });
  return html`<div class="field"><label for="f-feature">feature</label><span class="row">
      <${Choice} id="f-feature" current=${want.feature} options=${named(vocabulary.value.features.map((each) => local(each.name)))} choose=${set("feature")} />
      ${feature?.unit && html`<span class="faint">${unit(feature.unit)}</span>`}</span><small>${feature?.doc}</small></div>
    <div class="field"><label for="f-sort">of every</label><${Choice} id="f-sort" current=${want.sort} options=${named(sorts())} choose=${set("sort")} /></div>
    <div class="field"><label for="f-object">or only of</label>
      <input id="f-object" type="text" placeholder="one object, such as uav1" value=${want.object} onInput=${(event) => set("object")(event.target.value)} /></div>
    <div class="field"><label for="f-stale">silent after</label>
      <input id="f-stale" type="text" placeholder="its usual intervals, or 10s" value=${want.staleness} onInput=${(event) => set("staleness")(event.target.value)} /></div>`;
}

function Gallery({ chosen, choose }) {
  return html`<section class="panel" aria-label="templates"><header><h2>What do you want to know?</h2></header>
    ${templates.value.map((each) => html`<button class="card" key=${each.name} aria-pressed=${each.name === chosen} onClick=${() => choose(each.name)}>
      <b>${words(each.name)}</b><span>${each.doc}</span></button>`)}
    ${isKnown.value && !templates.value.length && html`<${Empty} title="No event templates."><span>A template names an event and says how to detect it.</span>
      <code>dyknow template add --library high_speed</code><//>`}
    <button class="card" aria-pressed=${chosen === "feature"} onClick=${() => choose("feature")}><b>A feature, whatever streams have it</b>
      <span>The best stream now; another one when it falls silent or a better one comes.</span></button>
    <a class="card" href="#query/continuous"><b>Something else</b><span>Write a continuous query.</span></a></section>`;
}

function Answer({ plan, goal, window, trouble }) {
  if (!plan) {
    return html`<section class="panel" aria-label="plan"><header><h2>What would answer</h2></header>
      <${Empty} title=${trouble ? "Nothing answers this yet." : "The plan appears here."}>
        <span>${trouble ? "The form shows what is wrong." : "Nothing starts before you say so."}</span><//></section>`;
  }
  const stages = Object.fromEntries(plan.stages.map((each) => [each.title, each.text]));
  const details = { "The query that runs": stages.query, "How it is evaluated, and its cost": stages.evaluation, "The template": stages.template };
  const tree = window ? [{ text: `query over ${window}`, verdict: "", parts: plan.plan, reason: "" }] : plan.plan;
  return html`<section class="panel" aria-label="plan"><header><h2 class="grow">What would answer</h2>
    ${plan.cost != null && html`<span class="small faint">cost ${plan.cost}, quality ${plan.quality}${plan.proven ? ", proven best" : ""}</span>`}</header>
    <div class="body stack"><${PlanTree} goal=${goal} plan=${tree} />
      ${!plan.found && html`<div class="note warn"><b>Nothing answers this yet.</b> Each way above tells why it fails. Annotate a stream that has
        the feature, or add a transformation to it.</div>`}
      <div>${Object.entries(details).map(([name, text]) => text && html`<details key=${name}><summary>${name}</summary>
        <pre class="wide-code" tabindex="0">${text}</pre></details>`)}</div></div></section>`;
}

function Started({ made }) {
  const event = shown.value.last.get(made.stream), stream = byName.value.get(made.stream);
  const numbers = event ? Object.entries(event.values).filter(([, each]) => typeof each === "number") : [];
  return html`<div class="note" role="status"><b>It runs as ${made.id}.</b>
    ${event ? html` Last: <span class="mono">${event.object}</span> ${numbers.map(([name, each]) => `${name} ${value(each)}`).join(", ")}.` : " It waits for the first event."}
    ${stream && ` ${rate(stream.rate)}`} <a href=${`#live/${encodeURIComponent(made.stream)}`}>Follow it</a> ·
    <a href=${`#graph/${encodeURIComponent(made.stream)}`}>Where it comes from</a></div>`;
}

/** What a request would have given on what is kept. */
function Tried({ of }) {
  const times = of.results ? plural(of.results, "time") : "not once";
  const read = `${plural(of.samples, "kept sample")} from ${stamp(of.since)} to ${stamp(of.until)}`;
  const end = of.failure ? `, where it failed: ${of.failure}` : of.complete ? "" : ", when the time was over";
  return html`<div class="note" role="status">${of.until
    ? html`<b>It would have fired ${times}</b>${of.results ? `, last at ${stamp(of.last)}. ` : ". "}
      Tried on ${read}${end}.`
    : `It cannot be tried: ${of.failure ?? "no sample is kept"}.`}</div>`;
}

function Same({ list }) {
  if (!list.length) return null;
  return html`<div class="same"><h3 class="group">${plural(list.length, "request")} of this kind; an equal one shares its stream</h3>
    ${list.map((each) => html`<a class="item row" key=${each.id} href=${`#live/${encodeURIComponent(each.stream)}`}>
      <span class="mono faint">${each.id}</span><span class="grow"><${Chips} of=${each.chips.length ? each.chips : [each.name]} /></span>
      <span class="faint num">${rate(byName.value.get(each.stream)?.rate)}</span></a>`)}</div>`;
}

export default function Ask() {
  const [chosen, setChosen] = useState(null), [texts, setTexts] = useState({});
  const [want, setWant] = useState({ feature: "speed", sort: usual(), object: "", staleness: "" });
  const [options, setOptions] = useState({ strategy: "fast", since: "now" });
  const [plan, setPlan] = useState(null), [trouble, setTrouble] = useState(null);
  const [made, setMade] = useState(null), [isBusy, setBusy] = useState(false);
  const [tried, setTried] = useState({});
  tick.value;
  const isFeature = chosen === "feature";
  const template = isFeature ? null : templates.value.find((each) => each.name === chosen) ?? templates.value[0];
  const text = (use) => texts[use.name] ?? initial(use);
  const terms = template?.uses.map((use) => term(use, text(use)));
  const event = template && eventText(template, terms);
  const match = {
    feature: prefixed(want.feature), strategy: options.strategy,
    ...(want.object ? { objects: [prefixed(want.object)] } : { sort: prefixed(want.sort) }),
  };
  const wished = isFeature ? match : event && { event, strategy: options.strategy };
  const key = JSON.stringify(wished);
  const choose = (name) => {
    setChosen(name);
    setTexts({});
    setMade(null);
    setPlan(null);
    setTrouble(null);
  };
  useEffect(() => {
    if (!wished || !vocabulary.value.sorts.length) return undefined;
    let isCurrent = true;
    const due = setTimeout(async () => {
      try {
        const found = await (isFeature ? ask("/match", { method: "POST", body: match }) : explain(wished));
        if (!isCurrent) return;
        setPlan(isFeature ? { ...found, stages: [], plan: [found.tree] } : found);
        setTrouble(null);
      } catch (error) {
        if (!isCurrent) return;
        setPlan(null);
        setTrouble(error);
      }
    }, WAIT);
    return () => {
      isCurrent = false;
      clearTimeout(due);
    };
  }, [key, vocabulary.value.sorts.length]);
  const canTry = !isFeature && plan?.found && !isBusy, canStart = may("admin") && plan?.found && !isBusy;
  const tryIt = async () => {
    setBusy(true);
    try {
      setTried({ key, found: (await explain({ ...wished, since: "start" })).tried });
      setTrouble(null);
    } catch (error) {
      setTrouble(error);
    }
    setBusy(false);
  };
  const start = async () => {
    if (!canStart) return;
    setBusy(true);
    try {
      const asked = isFeature
        ? { path: "/subscriptions", body: { ...match, since: options.since, ...(want.staleness ? { staleness: want.staleness } : {}) } }
        : { path: "/events", body: { event: prefixed(template.local_name), arguments: terms, ...options } };
      setMade(await ask(asked.path, { method: "POST", body: asked.body }));
      setTrouble(null);
      say("It runs");
      refresh();
    } catch (error) {
      setTrouble(error);
    }
    setBusy(false);
  };
  useEffect(() => {
    const press = (pressed) => {
      if (pressed.key === "Enter" && (pressed.ctrlKey || pressed.metaKey)) start();
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  });
  const same = requests.value.filter((each) => isFeature ? each.adaptive : template && each.event === template.name);
  const goal = isFeature ? `${want.feature} of ${want.object || `every ${want.sort}`}`
    : `${template?.local_name}(${template?.uses.map((use) => (use.role === "object" && !text(use) ? "any" : text(use))).join(", ")})`;
  return html`<main class="page"><div class="ask">
    <${Gallery} chosen=${isFeature ? "feature" : template?.name} choose=${choose} />
    <section class="panel" aria-label="form"><header><h2>${isFeature ? "A feature" : template ? words(template.name) : "Nothing to ask yet"}</h2></header>
      <div class="body stack">
        ${isFeature ? html`<${FeatureForm} want=${want} setWant=${setWant} />`
          : template?.uses.map((use) => html`<${Argument} key=${template.name + use.name} use=${use} text=${text(use)}
              write=${(each) => setTexts({ ...texts, [use.name]: each })} />`)}
        <div class="field"><label for="strategy">prefer</label>
          <${Choice} id="strategy" current=${options.strategy} options=${Object.fromEntries(Object.keys(STRATEGIES).map((each) => [each, each.split(":")[0]]))}
            choose=${(strategy) => setOptions({ ...options, strategy })} /><small>${STRATEGIES[options.strategy]}</small></div>
        <div class="field"><span class="muted">begin</span><div><div class="tabs" role="group" aria-label="begin">${Object.entries(SINCE).map(([since, label]) =>
          html`<button aria-pressed=${options.since === since} onClick=${() => setOptions({ ...options, since })}>${label}</button>`)}</div></div></div>
        <${Trouble} of=${trouble} />
        <div class="row">${may("admin") && html`<button class="main" disabled=${!canStart} onClick=${start}>Start</button><span class="faint small wide"><kbd>Ctrl ⏎</kbd></span>`}
          ${!isFeature && html`<button disabled=${!canTry} title="how often it would have fired" onClick=${tryIt}>Try it on what is kept</button>`}</div>
        ${!may("admin") && html`<div class="note">Your token may read only. Starting a request needs scope admin.</div>`}
        ${tried.key === key && tried.found && html`<${Tried} of=${tried.found} />`}
        ${made && html`<${Started} made=${made} />`}</div>
      <${Same} list=${same} /></section>
    <${Answer} plan=${plan} goal=${goal} window=${template?.window} trouble=${trouble} /></div></main>`;
}
