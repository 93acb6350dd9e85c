// The text of a request: a template with a term for each parameter.
import { byName, vocabulary } from "./state.js";
import { local } from "./format.js";

export const prefixed = (name) => (name.includes(":") || name.startsWith("<") ? name : `dyknow:${name}`);
export const sorts = () => vocabulary.value.sorts.map((each) => local(each.name));
/** A sort that streams are about, so that the first plan is one. */
export const usual = () => [...byName.value.values()].flatMap((each) => each.ports).flatMap((port) => port.of)
  .filter((each) => each.every).map((each) => local(each.name))[0] ?? sorts()[0] ?? "Thing";

/** The text of a literal, else the term; nothing for a variable, which leaves an object free. */
function plain(argument) {
  if (argument.startsWith("?")) return "";
  return argument.startsWith('"') ? JSON.parse(argument.slice(0, argument.lastIndexOf('"') + 1)) : argument;
}

/** What the form of a parameter begins with: its default, else something that fits. */
const usualText = (use) => ({ sort: usual(), number: "100", feature: "speed", duration: "10s" })[use.role] ?? "";
export function initial(use) {
  if (use.default === null) return usualText(use);
  return use.role === "sort" || use.role === "feature" ? local(use.default) : plain(use.default);
}

/** The term for an argument, as a request has it. */
export function term(use, text) {
  if (use.default !== null && text === initial(use)) return use.default;
  if (use.role === "object") return text ? prefixed(text) : use.name;
  if (use.role === "sort" || use.role === "feature") return prefixed(text);
  return use.role === "number" ? text || "0" : JSON.stringify(text);
}

/** The event of a template with these terms, or with those that it begins with. */
export const eventText = (template, terms = template.uses.map((use) => term(use, initial(use)))) =>
  `${prefixed(template.local_name)}(${terms.join(", ")})`;
