// The partial matches of a running pattern: which events have come, and between which valid times each
// of the others may still come.
import { html, useEffect, useRef, useState } from "./vendor/preact.js";
import { PATTERN, held } from "./state.js";
import { address, ask } from "./http.js";
import { plural, stamp, value } from "./format.js";
import { Empty, Trouble } from "./widgets.js";

const EVERY = 2_000, LISTED = 20;

const said = (values) => Object.entries(values).map(([name, each]) => `${name} ${value(each)}`).join(", ");

/** One partial match: a line for each event that has come, then for each that may come. Times have no
    date on the day of `now`. */
const Match = ({ of, number, now }) => html`<tbody>
  <tr><th colspan="3" scope="rowgroup">${number}: ${plural(of.events.length, "event")} of ${of.events.length + of.pending.length}</th></tr>
  ${of.events.map((each) => html`<tr><td class="mono">${each.event}</td>
    <td>${stamp(each.valid, now)}</td><td>${said(each.values)}</td></tr>`)}
  ${of.pending.map((each) => html`<tr><td class="mono">${each.event}</td>
    <td class="accent">${stamp(each.earliest, now)}${each.latest ? ` to ${stamp(each.latest, now)}` : " or later"}</td>
    <td class="faint">may come</td></tr>`)}</tbody>`;

/** Why there is none. */
function None({ of, object, request }) {
  if (object) {
    return html`<${Empty} title=${`No partial match has ${object}.`}>
      <span>It has no event that could begin or continue a match, or the time for the others is over.</span><//>`;
  }
  if (request.state === "ended") {
    return html`<${Empty} title="No partial match."><span>The streams of the pattern have ended, so no other event can come.</span><//>`;
  }
  return of.watermark === null
    ? html`<${Empty} title="No partial match."><span>The pattern has read no sample yet.</span><//>`
    : html`<${Empty} title="No partial match."><span>No event has come that could begin a match, or the time for the others is over.</span><//>`;
}

/** What `path` answers, asked again while nothing is held; and the error in its place. */
function useAgain(path) {
  const [answer, setAnswer] = useState({});
  useEffect(() => {
    let due = 0, isOver = false;
    const next = async () => {
      if (!held.value && !document.hidden) {
        const now = await ask(path).then((found) => ({ found }), (trouble) => ({ trouble }));
        if (!isOver) setAnswer(now);
      }
      if (!isOver) due = setTimeout(next, EVERY);
    };
    next();
    return () => {
      isOver = true;
      clearTimeout(due);
    };
  }, [path]);
  return answer;
}

/** A dialog with the partial matches of a request, at first of `first`; `close` ends it. */
function Partials({ request, first, close }) {
  const box = useRef(), [object, setObject] = useState(first ?? "");
  const { found, trouble } = useAgain(address(`${request.address}/partial`, { object, limit: LISTED }));
  useEffect(() => box.current.showModal(), []);
  return html`<dialog ref=${box} class="why partial" aria-label="partial matches" onClose=${close}>
    <h2>${request.name}: ${found ? `${found.partial.length}${found.more ? " newest" : ""} ` : ""}partial ${found?.partial.length === 1 ? "match" : "matches"}</h2>
    <div class="row wraps"><label class="row muted">of <input type="search" class="short" placeholder="any object" value=${object}
        onInput=${(event) => setObject(event.target.value.trim())} /></label>
      ${found?.watermark && request.state !== "ended" && html`<span class="muted">No event before <span class="num">${stamp(found.watermark)}</span> comes any more.</span>`}</div>
    ${found?.partial.length > 0 && html`<div class="whytable" tabindex="0"><table>
      <thead><tr><th>event</th><th>valid</th><th>sample</th></tr></thead>
      ${found.partial.map((each, i) => html`<${Match} key=${i} of=${each} number=${i + 1} now=${found.watermark ?? Date.now()} />`)}</table></div>`}
    ${found?.more && html`<p class="small faint">There may be others. Name an object to see its own.</p>`}
    ${found?.partial.length === 0 && html`<${None} of=${found} object=${object} request=${request} />`}
    <${Trouble} of=${trouble} /><button onClick=${() => box.current.close()}>Close</button></dialog>`;
}

/** A button that opens the partial matches of a request; nothing where it is no pattern that runs. */
export function Partial({ request, object }) {
  const [isOpen, setOpen] = useState(false);
  if (request.gives !== PATTERN || !["running", "ended"].includes(request.state)) return null;
  return html`<button onClick=${() => setOpen(true)}>Partial matches</button>
    ${isOpen && html`<${Partials} request=${request} first=${object} close=${() => setOpen(false)} />`}`;
}
