// Why a verdict of a monitor is what it is: the states of its window, the features there, and the
// value of each part of the formula.
import { html, useEffect, useRef, useState } from "./vendor/preact.js";
import { byName, requests } from "./state.js";
import { address, ask } from "./http.js";
import { clock, value } from "./format.js";
import { Trouble } from "./widgets.js";

const MTL = "MTL", VERDICT = "verdict", STATES = 60;

/** The question for an event's explanation; null if the event is no verdict. */
export function question(event) {
  const request = requests.value.find((each) => each.stream === event.name);
  if (request?.dialect !== MTL || !(VERDICT in event.values)) return null;
  // The fields of a verdict begin with the objects, in the order of the parameters.
  const names = byName.value.get(event.name).fields.map((field) => field.name);
  const object = names.slice(0, names.indexOf(VERDICT)).map((name) => event.values[name]);
  return address(`/queries/${encodeURIComponent(request.id)}/why`, { object, start: event.valid });
}

const TONES = { true: "accent", false: "bad", unknown: "warn" };
const Cell = ({ of }) => html`<td class=${typeof of === "number" ? "num" : TONES[String(of)] ?? "faint"}>${value(of)}</td>`;

function Table({ of }) {
  const rows = [...of.features, ...of.formulas], states = of.states.slice(0, STATES);
  return html`<div class="whytable" tabindex="0"><table>
    <thead><tr><th>part</th>${states.map((state) => html`<th class="num">${clock(state)}</th>`)}</tr></thead>
    <tbody>${rows.map((row) => html`<tr><td class="mono" style=${{ paddingLeft: `${12 + 16 * row.depth}px` }}>${row.text}</td>
      ${states.map((_, i) => html`<${Cell} of=${row.values[i]} />`)}</tr>`)}</tbody></table></div>
    ${of.states.length > STATES && html`<p class="small faint">The first ${STATES} of ${of.states.length} states.</p>`}`;
}

/** A dialog with the answer to `path`; `close` ends it. */
export function Why({ path, close }) {
  const box = useRef(), [found, setFound] = useState(null), [trouble, setTrouble] = useState(null);
  useEffect(() => {
    box.current.showModal();
    ask(path).then(setFound).catch(setTrouble);
  }, [path]);
  return html`<dialog ref=${box} class="why" aria-label="why" onClose=${close}>
    <h2>${found ? `${Object.values(found.objects).join(", ")}: ${found.verdict}` : "Why?"}</h2>
    ${found && html`<p class="muted">${found.query} from ${clock(found.start)}${found.decided && `, decided by ${clock(found.decided)}`}</p><${Table} of=${found} />`}
    <${Trouble} of=${trouble} /><button onClick=${() => box.current.close()}>Close</button></dialog>`;
}
