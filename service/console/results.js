// What a sample says: a verdict and a match in words, other values with their units.
import { html } from "./vendor/preact.js";
import { MONITOR, PATTERN, asked, byName, objectField, told, unitOf } from "./state.js";
import { clock, value } from "./format.js";

const SHOWN_FIELDS = 4;
/** Each verdict as a word about the rule, and its tone. */
export const VERDICTS = { true: ["holds", "accent"], false: ["violated", "bad"], unknown: ["unknown", "warn"] };

const Time = ({ of }) => html`<span class="num" title=${of}>${clock(of)}</span>`;

/** The state that bears witness says when; a run of equal verdicts, how long. `brief`: without the
    event's own time. */
function Verdict({ of, brief }) {
  const { verdict, decided, witness, last } = of.values, at = witness ?? of.valid;
  const [word, tone] = VERDICTS[verdict] ?? [verdict, ""];
  const isLater = decided && clock(decided) !== clock(last ?? at);
  const when = last ? html` <span class="faint">from</span> <${Time} of=${of.valid} /> <span class="faint">to</span> <${Time} of=${last} />`
    : (!brief || clock(at) !== clock(of.valid)) && html` <span class="faint">at</span> <${Time} of=${at} />`;
  return html`<b class=${tone}>${word}</b>${when}${isLater && html` <span class="faint">decided</span> <${Time} of=${decided} />`} `;
}

function Match({ of, brief }) {
  const { start, end } = of.values, isOther = !brief || clock(end) !== clock(of.valid);
  return html`<b class="accent">matched</b> <span class="faint">from</span> <${Time} of=${start} />${isOther
    && html` <span class="faint">to</span> <${Time} of=${end} />`} `;
}

const WORDS = { [MONITOR]: Verdict, [PATTERN]: Match };

/** What an event says of its object. */
export function Values({ of, brief = false }) {
  const stream = byName.value.get(of.name), id = stream && objectField(stream);
  const Words = WORDS[asked.value.get(of.name)?.gives], inWords = told(of.name);
  const fields = Object.entries(of.values)
    .filter(([name, each]) => name !== id && each != null && !inWords.includes(name));
  return html`${Words && html`<${Words} of=${of} brief=${brief} />`}
    ${fields.slice(0, SHOWN_FIELDS).map(([name, each]) => {
      const unit = stream && unitOf(stream, name);
      return html`<span class="faint">${name} </span><span class="num">${value(each)}</span>
        ${unit && html`<span class="faint"> ${unit}</span>`} `;
    })}`;
}
