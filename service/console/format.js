// Numbers, times and names as people read them. Pure functions: node tests them without a browser.

export function duration(seconds) {
  if (seconds == null || Number.isNaN(seconds)) return "–";
  if (seconds < 5e-4) return "0 ms";
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 120) return `${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${(seconds / 3600).toFixed(1)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

/** How long ago, or in how long: 5 s ago, now, in 4 h. */
export function ago(seconds) {
  if (seconds == null || Number.isNaN(seconds)) return "–";
  if (Math.abs(seconds) < 2) return "now";
  return seconds < 0 ? `in ${duration(-seconds)}` : `${duration(seconds)} ago`;
}

// Made once: a formatter costs more than what it formats.
const numbers = [0, 1, 3].map((digits) => new Intl.NumberFormat("en-US", { maximumFractionDigits: digits }));
const times = new Intl.DateTimeFormat("en-GB", { timeStyle: "medium" });
const days = new Intl.DateTimeFormat("en-CA");

export const count = (value) => (value == null ? "–" : numbers[0].format(Math.round(value)));

export function rate(value) {
  if (value == null) return "–";
  if (value >= 1000) return `${(value / 1000).toFixed(1)} k/s`;
  return `${value >= 9.95 ? Math.round(value) : value.toFixed(1)}/s`;
}

export function bytes(value) {
  if (value == null) return "–";
  if (value >= 2 ** 30) return `${(value / 2 ** 30).toFixed(1)} GiB`;
  return value >= 2 ** 20 ? `${Math.round(value / 2 ** 20)} MiB` : `${Math.round(value / 1024)} KiB`;
}

const formatted = (format, time) => {
  const date = new Date(time);
  return Number.isNaN(+date) ? "–" : format.format(date);
};

/** The time of day of a number of ms, or of a text in ISO-8601. */
export const clock = (time) => formatted(times, time);

/** The day, as 2026-05-04. */
export const day = (time) => formatted(days, time);

/** The time of day, with its milliseconds if it has some, after the date where that is not the day of
    `near`. */
export function stamp(time, near = Date.now()) {
  const part = new Date(time).getMilliseconds();
  const exact = part ? `${clock(time)}.${String(part).padStart(3, "0")}` : clock(time);
  return day(time) === day(near) ? exact : `${day(time)} ${exact}`;
}

/** 1 unit, 2 units. */
export const plural = (number, noun) => `${count(number)} ${noun}${number === 1 ? "" : "s"}`;

/** A number with up to three digits after the point. */
export const decimal = (number) => numbers[2].format(number);

/** A value of a sample: numbers with few digits, nothing as a dash. */
export function value(of) {
  if (of == null) return "–";
  if (typeof of !== "number") return String(of);
  return numbers[Number.isInteger(of) ? 0 : Math.abs(of) < 10 ? 2 : 1].format(of);
}

/** The last part of an IRI or prefixed name: dyknow:speed → speed. */
export function local(name) {
  const cut = Math.max(name.lastIndexOf("/"), name.lastIndexOf("#"), name.lastIndexOf(":"));
  const part = name.slice(cut + 1);
  return part.endsWith(">") ? part.slice(0, -1) : part;
}

/** HighSpeedEvent → High speed event. */
export function words(name) {
  let text = "";
  for (const letter of local(name)) {
    const begins = letter !== letter.toLowerCase() && text && !text.endsWith(" ");
    text += begins ? ` ${letter.toLowerCase()}` : letter === "_" ? " " : letter;
  }
  return text.slice(0, 1).toUpperCase() + text.slice(1);
}

/** A unit of SSL as people write it: km.h-1 → km/h, m.s-2 → m/s²; nothing for what has none. */
export function unit(text) {
  if (text === "no_unit") return "";
  const powers = { 1: "", 2: "²", 3: "³" };
  let above = "", below = "";
  for (const part of (text ?? "").split(".")) {
    const at = [...part].findIndex((letter) => letter === "-" || (letter >= "0" && letter <= "9"));
    const name = at < 0 ? part : part.slice(0, at), power = at < 0 ? 1 : Number(part.slice(at));
    if (!name || !(Math.abs(power) in powers)) return text ?? "";
    if (power > 0) above += (above && "·") + name + powers[power];
    else below += `/${name}${powers[-power]}`;
  }
  return (above || (below && "1")) + below;
}

/** An IRI with one of the prefixes of /vocabulary. */
export function shorten(iri, prefixes) {
  for (const [prefix, long] of Object.entries(prefixes)) {
    if (iri.startsWith(long) && iri.length > long.length) return `${prefix}:${iri.slice(long.length)}`;
  }
  return iri;
}
