// What runs, what it reports, and where. A chosen request filters the list, the map and the plot; a
// chosen object follows through all three.
import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { byName, held, isKnown, may, moment, numbers, place, requests, status, streams, templates, unitOf } from "../state.js";
import { arrivals, feedState, isThinned, newest, oldest, past, play, shown, tick } from "../feed.js";
import { ago, clock, count, plural, rate, stamp, words } from "../format.js";
import { ask } from "../http.js";
import { TrackMap } from "../map.js";
import { eventText } from "../terms.js";
import { Values } from "../results.js";
import { end } from "../ending.js";
import { Partial } from "../partial.js";
import { Why, question } from "../why.js";
import { Chips, Empty, Plot, Rows, Trouble, aligned, theme } from "../widgets.js";

const STATES = ["failed", "running", "ended"];
const LINES = 24, PLOTTED = 90, RECENT = 10, LISTED = 3;
const PLAYED_FIRST = 30_000, SECOND = 1_000;
/** A line goes on over a gap of this part of what is plotted. */
const GAPS = 20;

function Request({ request, isChosen, choose }) {
  const event = shown.value.last.get(request.stream), stream = byName.value.get(request.stream);
  const now = moment.value ?? Date.now(), age = event ? (now - event.time) / 1000 : null;
  const { state } = request, isBad = state === "failed";
  const dot = { failed: "bad", ended: "", running: age !== null && Math.abs(age) < RECENT ? "on" : "" }[state] ?? "warn";
  return html`<button class="ask-row" aria-pressed=${isChosen} onClick=${choose}>
    <span class="row"><i class=${`dot ${dot}`} title=${state}></i>
      <span class="name cut grow">${request.name}</span><span class="faint small num">${state === "ended" ? state : rate(stream?.rate)}</span></span>
    ${request.chips.length > 0 && html`<${Chips} of=${request.chips} />`}
    <span class="said cut">${request.problem ? html`<span class=${isBad ? "bad" : "warn"}>${request.problem}</span>`
      : event ? html`<span class="mono">${event.object}</span> <${Values} of=${event} />
        <span class="faint">· ${ago(age)}</span>`
      : html`<span class="faint" title=${request.empty}>${request.empty ?? "no event yet"}</span>`}</span></button>`;
}

/** The states that requests are listed by, each with those that have it. */
function groups() {
  const states = Map.groupBy(requests.value, (each) => each.state);
  const others = [...states.keys()].filter((each) => !STATES.includes(each));
  return [...others, ...STATES].filter((each) => states.has(each)).map((each) => [each, states.get(each)]);
}

/** A request that this service can answer, or how to get a template first. */
function Proposal() {
  const [template] = templates.value;
  if (template) return html`<code>dyknow events '${eventText(template)}' --since start --keep</code>`;
  return html`<span>There is no event template yet. Add one of the library:</span>
    <code>dyknow template add --library high_speed</code>`;
}

/** Streams whose samples can be seen although nothing asks for them. */
function Played() {
  const played = streams.value.filter((each) => !each.producer && each.name !== "status" && each.counters.accepted);
  return played.slice(0, LISTED).map((each) => html`<a key=${each.name} href=${`#graph/${encodeURIComponent(each.name)}`}>
    See the ${plural(each.counters.accepted, "sample")} of ${each.name}</a>`);
}

function Requests({ chosen, object }) {
  const [trouble, setTrouble] = useState(null);
  const go = (request) => {
    location.hash = request === chosen ? "live" : `live/${encodeURIComponent(request.stream)}`;
  };
  return html`<section class="panel asks" aria-label="requests"><header><h2 class="grow">Requests</h2>
    <a class="small" href="#ask">Ask for more</a></header>
    <div class="scroll">${groups().map(([state, list]) => html`<section key=${state} aria-label=${`${state} requests`}>
        <h3 class="group">${words(state)} <span class="faint num">${count(list.length)}</span></h3>
        ${list.map((request) => html`<${Request} key=${request.kind + request.id} request=${request}
          isChosen=${request === chosen} choose=${() => go(request)} />`)}</section>`)}
      ${isKnown.value && !requests.value.length && html`<${Empty} title="No requests run.">
        <span>Say what you want to know; DyKnow finds or builds the streams that answer it.</span>
        <a href="#ask">Ask for an event</a>
        <${Played} />
        <${Proposal} /><//>`}</div>
    <${Trouble} of=${trouble} />
    ${chosen && html`<footer class="row"><a class="grow small" href=${`#graph/${encodeURIComponent(chosen.stream)}`}>Where it comes from</a>
      <${Partial} key=${chosen.id} request=${chosen} object=${object} />
      ${may("admin") && html`<button class="danger" onClick=${() => end(chosen).then(() => { location.hash = "live"; }, setTrouble)}>End it</button>`}</footer>`}</section>`;
}

/** A gap of the connection concerns all streams. */
const isOfAll = (event) => event.gap && !event.name;

function Feed({ chosen, object, select, all, setAll, isWanted }) {
  const [find, setFind] = useState(""), [asked, setAsked] = useState(null), frozen = useRef(null), byScroll = useRef(false);
  if (held.value) frozen.current ??= { events: shown.value.events.slice(), total: arrivals.value.total };
  else frozen.current = null;
  const text = find.toLowerCase();
  const fits = (event) => isOfAll(event) || isWanted(event.name) && (!object || event.object === object)
    && (!text || String(event.object).toLowerCase().includes(text));
  const events = (frozen.current?.events ?? shown.value.events).filter(fits).reverse();
  const names = new Map(requests.value.map((request) => [request.stream, request.name]));
  const scrolled = (isAway) => {
    if (isAway && !held.value) held.value = byScroll.current = true;
    else if (!isAway && byScroll.current) held.value = byScroll.current = false;
  };
  const row = (event, at) => event.gap
    ? html`<div class="line gap" key=${event.number} style=${at}><time>${clock(event.time)}</time>
        <span class="cut">${event.gap.detail ?? `samples ${event.gap.from} to ${event.gap.to ?? "?"} are not kept any more`}</span></div>`
    : html`<div class=${`line ${object && event.object === object ? "on" : ""}`} key=${event.number} style=${at}>
        <time>${clock(event.time)}</time><span class="cut of muted">${names.get(event.name) ?? event.name}</span>
        <button class="cut who" onClick=${() => select(event.object)}>${event.object ?? "–"}</button>
        <span class="cut">${question(event) && html`<button class="chip" onClick=${() => setAsked(question(event))}>why?</button> `}<${Values} of=${event} brief=${true} /></span></div>`;
  return html`<section class="panel feed" aria-label="events"><header>
    ${chosen ? html`<h2>Events</h2><a class="chip on" href="#live" title="show all">${chosen.name} ✕</a>`
      : html`<div class="tabs" role="group" aria-label="which">
          <button aria-pressed=${!all} onClick=${() => setAll(false)}>Events</button>
          <button aria-pressed=${all} onClick=${() => setAll(true)}>All results</button></div>`}
    ${object && html`<button class="chip on" onClick=${() => select(null)} title="show all objects">${object} ✕</button>`}
    <span class="grow"></span>
    ${held.value && html`<span class="small accent num">held, +${count(arrivals.value.total - frozen.current.total)}</span>`}
    ${isThinned.value && html`<span class="small faint" title="This page cannot read all samples as fast as they come. It shows the newest of each object, four times a second, until it is loaded again.">newest only</span>`}
    ${feedState.value === "waiting" && html`<span class="small warn">reconnecting</span>`}
    ${feedState.value === "ended" && html`<span class="small faint" title="all streams of the requests have ended">ended</span>`}
    <span class="small faint num wide">${rate(arrivals.value.rate)}</span>
    <input type="search" class="short" placeholder="object" aria-label="filter by object" value=${find}
      onInput=${(event) => setFind(event.target.value)} /></header>
    ${events.length ? html`<${Rows} items=${events} draw=${row} label="events" scrolled=${scrolled} />`
      : html`<${Empty} title="No events yet."><span>${requests.value.length
          ? "They appear here as they arrive, newest first. A request that never fires may ask for too much: its plan is on the Graph page."
          : "Events of all requests appear here as they arrive."}</span><//>`}
    ${asked && html`<${Why} path=${asked} close=${() => setAsked(null)} />`}</section>`;
}

/** The kept history of a field, where its newest sample is too old for a plot of the present: lines as
    `past` gives them. */
function usePast(stream, field) {
  const [found, setFound] = useState(null);
  const age = stream?.last_valid ? Date.now() - Date.parse(stream.last_valid) : 0;
  const isOld = moment.value === null && Boolean(field) && age > PLOTTED * SECOND;
  useEffect(() => {
    setFound(null);
    let isCurrent = true;
    if (isOld) past(stream, field).then((lines) => isCurrent && setFound(lines)).catch(() => {});
    return () => { isCurrent = false; };
  }, [isOld, stream?.name, field, stream?.last]);
  return isOld ? found : null;
}

/** All that is kept of a stream whose samples are old. */
function PastPlot({ request, stream, field, object, lines }) {
  const shown = lines.slice(0, LINES), times = shown.flatMap(([, points]) => [points[0][0], points.at(-1)[0]]);
  const from = Math.min(...times), until = Math.max(...times);
  const focus = Math.max(0, shown.findIndex(([name]) => name === object));
  return html`<section class="panel plot" aria-label="plot"><header>
    <h2 class="cut grow">${field} <span class="faint">${unitOf(stream, field)} · ${request.name}</span></h2>
    <span class="small faint num cut" title="all that is kept">${stamp(from * SECOND)} to ${stamp(until * SECOND, from * SECOND)}</span>
    <span class="small accent mono">${shown[focus][0]}</span></header>
    <${Plot} data=${() => aligned(shown.map(([, points]) => points), Math.max(5, (until - from) / GAPS))} focus=${focus + 1}
      tick=${`${stream.last}${stream.name}`} label=${`${field} over time`} names=${shown.map(([name]) => String(name))} name=${`${request.name}-${field}`} /></section>`;
}

function LivePlot({ request, object }) {
  const stream = byName.value.get(request?.stream), series = shown.value.series.get(request?.stream);
  const field = stream && numbers(stream)[0], kept = usePast(stream, field);
  if (kept?.length) return html`<${PastPlot} request=${request} stream=${stream} field=${field} object=${object} lines=${kept} />`;
  if (!field || !series) {
    const words = !stream ? "The first number of the chosen request, a line for each object."
      : field ? `${request.name} has no values yet.` : `${request.name} has no numbers to plot.`;
    return html`<section class="panel plot" aria-label="plot"><header><h2>Plot</h2></header><${Empty}><span>${words}</span><//></section>`;
  }
  const from = (moment.value ?? Date.now()) - PLOTTED * 1000;
  const lines = [...series].filter(([, events]) => events.at(-1).time > from)
    .sort((a, b) => b[1].at(-1).time - a[1].at(-1).time).slice(0, LINES);
  const focus = Math.max(0, lines.findIndex(([name]) => name === object));
  const data = () => aligned(lines.map(([, events]) => events.filter((each) => each.time > from)
    .map((each) => [each.time / 1000, each.values[field]])));
  return html`<section class="panel plot" aria-label="plot"><header>
    <h2 class="cut grow">${field} <span class="faint">${unitOf(stream, field)} · ${request.name}</span></h2>
    <span class="small accent mono">${lines[focus]?.[0]}</span></header>
    ${lines.length ? html`<${Plot} data=${data} focus=${focus + 1} tick=${`${tick.value}${request.stream}`}
        label=${`${field} over time`} names=${lines.map(([name]) => String(name))} name=${`${request.name}-${field}`} />`
      : html`<${Empty}><span>No values in the last ${PLOTTED} s.</span><//>`}</section>`;
}

/** The slider over the kept history of the streams that are shown: how it was, or the present. */
function Playback() {
  const [isPlaying, setPlaying] = useState(false), [from, setFrom] = useState(null);
  const until = newest(), time = moment.value;
  useEffect(() => {
    if (!isPlaying || time === null) return undefined;
    const due = setTimeout(() => {
      const next = time + SECOND;
      if (next >= until) stop();
      else play(next);
    }, 500);
    return () => clearTimeout(due);
  }, [isPlaying, time, shown.value]);
  const stop = () => {
    setPlaying(false);
    setFrom(null);
    play(null);
  };
  const open = async () => {
    const first = await oldest();
    setFrom(first);
    play(Math.max(first ?? 0, newest() - PLAYED_FIRST));
  };
  if (time === null) return html`<div class="over beside"><button onClick=${open} title="show how it was">Playback</button></div>`;
  return html`<div class="over playback">
    <button onClick=${() => setPlaying(!isPlaying)} aria-label=${isPlaying ? "stop" : "play, twice as fast"}>${isPlaying ? "❚❚" : "▶"}</button>
    <input type="range" aria-label="time" min=${from ?? time} max=${Math.max(until, time)} step="1000" value=${time}
      onInput=${(event) => play(Number(event.target.value))} />
    <time class="num small">${stamp(Math.floor(time / SECOND) * SECOND)}</time><button onClick=${stop}>Now</button></div>`;
}

/** A line in place of the map, where no stream has positions. */
const NoMap = () => html`<section class="panel map" aria-label="map"><header>
  <details class="grow"><summary>No stream has positions</summary><div class="stack small muted">
    <span>Annotate one that has latitude and longitude; its objects appear on a map here.</span>
    <code>dyknow annotate 'stream gps contains latitude(Car) = lat, longitude(Car) = lon for every Car = id'</code></div></details>
  <${Playback} /></header></section>`;

export default function Live({ rest }) {
  const [object, select] = useState(null), [all, setAll] = useState(false);
  tick.value;
  theme.value;
  const list = requests.value, chosen = list.find((request) => request.stream === rest);
  // Events are no results: 30 results a second of a query would hide two events a second.
  const events = list.filter((request) => request.kind === "event");
  const wanted = new Set((chosen ? [chosen] : all || !events.length ? list : events).map((each) => each.stream));
  const isWanted = (stream) => wanted.has(stream);
  const latest = (request) => shown.value.last.get(request.stream)?.time ?? 0;
  const now = moment.value ?? Date.now(), candidates = [...events, ...list];
  const plotted = chosen ?? candidates.find((each) => now - latest(each) < PLOTTED * 1000)
    ?? candidates.find(latest);
  const hasMap = !status.value || shown.value.tracks.size > 0 || streams.value.some(place);
  return html`<main class="page fill"><div class=${`live ${hasMap ? "" : "flat"}`}>
    <${Requests} chosen=${chosen} object=${object} />
    <${Feed} chosen=${chosen} object=${object} select=${select} all=${all} setAll=${setAll} isWanted=${isWanted} />
    ${hasMap ? html`<section class="panel map" aria-label="map"><div class="sheet">
      ${shown.value.tracks.size ? html`<${TrackMap} selected=${object} select=${select} isWanted=${isWanted} />`
        : status.value && html`<${Empty} title="No positions yet."><span>The objects of streams with latitude and longitude appear here.</span><//>`}
      <${Playback} /></div></section>` : html`<${NoMap} />`}
    <${LivePlot} request=${plotted} object=${object} />
  </div></main>`;
}
