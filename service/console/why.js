// Why a verdict or a match is what it is. Of a verdict: the states of its window, the features there,
// and the value of each part of the formula. Of matches: the samples that are their events.
import { html, useEffect, useRef, useState } from "./vendor/preact.js";
import { MONITOR, PATTERN, asked, byName } from "./state.js";
import { address, ask } from "./http.js";
import { clock, value } from "./format.js";
import { VERDICTS } from "./results.js";
import { Trouble } from "./widgets.js";

const VERDICT = "verdict", STATES = 60;

/** The question for an event's explanation; null if the event is neither verdict nor match. */
export function question(event) {
  const request = asked.value.get(event.name), stream = byName.value.get(event.name);
  if (!stream || ![MONITOR, PATTERN].includes(request?.gives)) return null;
  const path = `${request.address}/why`;
  if (request.gives === PATTERN) return address(path, { start: event.valid });
  // The fields of a verdict begin with the objects, in the order of the parameters.
  const names = stream.fields.map((field) => field.name);
  const object = names.slice(0, names.indexOf(VERDICT)).map((name) => event.values[name]);
  return address(path, { object, start: event.valid });
}

const TONES = { true: "accent", false: "bad", unknown: "warn" };
const Cell = ({ of }) => html`<td class=${typeof of === "number" ? "num" : TONES[String(of)] ?? "faint"}>${value(of)}</td>`;

/** The states around the start of the verdict, which is in view, whatever came long before it. */
function Table({ of }) {
  const box = useRef(), start = of.states.indexOf(of.start);
  const from = Math.max(0, Math.min(start - STATES / 2, of.states.length - STATES));
  const rows = [...of.features, ...of.formulas], states = of.states.slice(from, from + STATES);
  useEffect(() => {
    box.current.querySelector("th.accent")?.scrollIntoView({ block: "nearest", inline: "center" });
  }, [of]);
  return html`<div class="whytable" ref=${box} tabindex="0"><table>
    <thead><tr><th>part</th>${states.map((state, i) => html`<th class=${from + i === start ? "num accent" : "num"}>${clock(state)}</th>`)}</tr></thead>
    <tbody>${rows.map((row) => html`<tr><td class="mono" style=${{ paddingLeft: `${12 + 16 * row.depth}px` }}>${row.text}</td>
      ${states.map((_, i) => html`<${Cell} of=${row.values[from + i]} />`)}</tr>`)}</tbody></table></div>
    ${of.states.length > STATES && html`<p class="small faint">${STATES} of ${of.states.length} states, around the start.</p>`}`;
}

const said = (values) => Object.entries(values).map(([name, each]) => `${name} ${value(each)}`).join(", ");

/** The samples of a match, each with its name in the pattern. */
const Match = ({ of }) => html`<h3>${clock(of.start)} to ${clock(of.end)} <span class="muted">${said(of.values)}</span></h3>
  <div class="whytable" tabindex="0"><table><thead><tr><th>event</th><th>valid</th><th>stream</th><th>sample</th></tr></thead>
    <tbody>${of.events.map((each) => html`<tr><td class="mono">${each.event}</td><td class="num">${clock(each.valid)}</td>
      <td class="mono">${each.stream}</td><td>${said(each.values)}</td></tr>`)}</tbody></table></div>`;

const Verdict = ({ of }) => html`<h2>${Object.values(of.objects).join(", ")}: ${VERDICTS[of.verdict]?.[0] ?? of.verdict}</h2>
  <p class="muted">${of.query} from ${clock(of.start)}${of.decided && `, decided by ${clock(of.decided)}`}</p><${Table} of=${of} />`;
const Matches = ({ of }) => html`<h2>${of.query}: ${of.matches.length === 1 ? "1 match" : `${of.matches.length} matches`}</h2>
  ${of.matches.map((each) => html`<${Match} of=${each} />`)}`;

/** A dialog with the answer to `path`; `close` ends it. */
export function Why({ path, close }) {
  const box = useRef(), [found, setFound] = useState(null), [trouble, setTrouble] = useState(null);
  useEffect(() => {
    box.current.showModal();
    ask(path).then(setFound).catch(setTrouble);
  }, [path]);
  return html`<dialog ref=${box} class="why" aria-label="why" onClose=${close}>
    ${!found ? html`<h2>Why?</h2>` : found.matches ? html`<${Matches} of=${found} />` : html`<${Verdict} of=${found} />`}
    <${Trouble} of=${trouble} /><button onClick=${() => box.current.close()}>Close</button></dialog>`;
}
