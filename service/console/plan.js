// The tree of a plan: what was chosen, what else was considered, and why not.
import { html } from "./vendor/preact.js";
import { makers } from "./state.js";

const DEEPEST_MAKERS = 6;
const TONES = { chosen: "accent", failed: "warn" };
const plain = (text) => text.replaceAll("dyknow:", "");

/** What makes a stream that exists: a line for each unit above it. */
function origins(stream, depth = 0) {
  const unit = makers.value.get(stream);
  if (!unit || depth > DEEPEST_MAKERS) return [];
  const text = `made by ${unit.transformation} from ${unit.inputs.join(", ")}`;
  return [{ text, kind: "made", parts: unit.inputs.flatMap((input) => origins(input, depth + 1)) }];
}

function Step({ step }) {
  const { verdict } = step;
  const parts = verdict === "chosen" || verdict === "" ? [...(step.stream ? origins(step.stream) : []), ...step.parts] : step.parts;
  const kind = step.kind ?? (verdict === "chosen" ? "chosen" : verdict ? "other" : "");
  return html`<li><span class=${`step ${kind}`}>
    ${verdict && html`<span class=${`small ${TONES[verdict] ?? "faint"}`}>${verdict}</span>`}
    <span>${plain(step.text)}${step.reason && html` <span class="warn">— ${plain(step.reason)}</span>`}</span></span>
    ${parts.length > 0 && html`<ul>${parts.map((part) => html`<${Step} step=${part} />`)}</ul>`}</li>`;
}

/** The trees of `plan`, below what they answer. */
export const PlanTree = ({ goal, plan }) => html`<ul class="tree" aria-label="plan">
  <${Step} step=${{ text: goal, kind: "event", verdict: "", parts: plan }} /></ul>`;
