// The text of a request: a template with a term for each parameter.
import { byName, vocabulary } from "./state.js";
import { local } from "./format.js";

export const prefixed = (name) => (name.includes(":") || name.startsWith("<") ? name : `dyknow:${name}`);
export const sorts = () => vocabulary.value.sorts.map((each) => local(each.name));
/** A sort that streams are about, so that the first plan is one. */
export const usual = () => [...byName.value.values()].flatMap((each) => each.ports).flatMap((port) => port.of)
  .filter((each) => each.every).map((each) => local(each.name))[0] ?? sorts()[0] ?? "Thing";
export const initial = (use) => ({ sort: usual(), number: "100", feature: "speed", duration: "10s" })[use.role] ?? "";

/** The term for an argument, as a request has it. */
export function term(use, text) {
  if (use.role === "object") return text ? prefixed(text) : use.name;
  if (use.role === "sort" || use.role === "feature") return prefixed(text);
  return use.role === "number" ? text || "0" : JSON.stringify(text);
}

/** The event of a template with these terms, or with those that it begins with. */
export const eventText = (template, terms = template.uses.map((use) => term(use, initial(use)))) =>
  `${prefixed(template.local_name)}(${terms.join(", ")})`;
