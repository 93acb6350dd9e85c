// Small parts that all pages use.
import { html, signal, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import uPlot from "./vendor/uplot.js";
import { clock, day, decimal, stamp, value } from "./format.js";

const dark = matchMedia("(prefers-color-scheme: dark)").matches;
export const theme = signal(localStorage.theme ?? (dark ? "dark" : "light"));
export const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** The pen of a canvas, which becomes as large as its element, and empty. */
export function penOf(canvas) {
  const pen = canvas.getContext("2d"), { clientWidth: width, clientHeight: height } = canvas;
  const [wide, high] = [width, height].map((size) => Math.round(size * devicePixelRatio));
  if (canvas.width !== wide) canvas.width = wide;
  if (canvas.height !== high) canvas.height = high;
  pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

/** A message that disappears: {text, undo}. */
export const toast = signal(null);
const SHOWN = 5_000;
export function say(text, undo) {
  const own = { text, undo };
  toast.value = own;
  setTimeout(() => { if (toast.value === own) toast.value = null; }, SHOWN);
}

export function download(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

export const Empty = ({ title, children }) =>
  html`<div class="empty">${title && html`<b>${title}</b>`}${children}</div>`;

export const Chips = ({ of }) =>
  html`<span class="chips">${of.map((each) => html`<span class="chip" key=${each}>${each}</span>`)}</span>`;

/** A problem document as the service wrote it, with the place in the text where there is one. */
export function Trouble({ of }) {
  if (!of) return null;
  return html`<div class="note bad" role="alert">
    <b>${of.title ?? "Error"}</b> ${of.detail ?? of.message}
    ${of.line && html` <span class="num">(line ${of.line}, column ${of.column})</span>`}
    ${of.excerpt && html`<pre>${of.excerpt}</pre>`}
    ${of.missing?.length > 0 && html`<ul>${of.missing.map((each) => html`<li>${each}</li>`)}</ul>`}
    ${of.hint && html`<div class="muted">${of.hint}</div>`}</div>`;
}

export function Spark({ points, width = 120, height = 18 }) {
  if (points.length < 2) return html`<svg width=${width} height=${height} aria-hidden="true" />`;
  const top = Math.max(...points, 1e-9);
  const path = points.map((y, i) => {
    const at = [(i / (points.length - 1)) * width, height - 1 - (y / top) * (height - 2)];
    return `${i ? "L" : "M"}${at[0].toFixed(1)} ${at[1].toFixed(1)}`;
  });
  return html`<svg class="spark" width=${width} height=${height} viewBox=${`0 0 ${width} ${height}`}
    aria-hidden="true"><path d=${path.join("")} /></svg>`;
}

/** Lines over time. `data()` returns [times in s, ...lines]; line number `focus` has the accent, all
    others are grey. `names` of the lines stand at their ends, and the nearest one's under the pointer.
    A changed `tick` draws it again. */
export function Plot({ data, focus = 1, tick, label, names = [], zero = false, name = "plot" }) {
  const box = useRef(), plot = useRef(), lines = useRef(0), named = useRef();
  const [pointed, setPointed] = useState(null);
  named.current = names;
  const size = () => ({ width: box.current.clientWidth, height: box.current.clientHeight });
  const build = () => {
    plot.current?.destroy();
    plot.current = null;
    const found = data();
    if (!box.current?.clientWidth || !found[0].length) return;
    lines.current = found.length;
    const hooks = {
      draw: [(drawn) => nameEnds(drawn, named.current, focus)],
      setCursor: [(drawn) => setPointed(nearest(drawn, named.current))],
    };
    plot.current = new uPlot({ ...size(), ...options(found.length, focus, zero), hooks }, found, box.current);
  };
  useEffect(() => {
    build();
    const watch = new ResizeObserver(() => {
      if (!box.current) return;
      if (plot.current) plot.current.setSize(size());
      else build();
    });
    watch.observe(box.current);
    return () => {
      watch.disconnect();
      plot.current?.destroy();
    };
  }, [theme.value, focus]);
  useEffect(() => {
    const found = data();
    if (!plot.current || !found[0].length || found.length !== lines.current) build();
    else plot.current.setData(found);
  }, [tick]);
  const save = () => plot.current?.ctx.canvas.toBlob((blob) => download(`${name}.png`, blob));
  return html`<div class="plotted"><div ref=${box} class="plotbox" role="img" aria-label=${names.length ? `${label}: ${names.join(", ")}` : label} />
    ${pointed && html`<div class="pointed small num" aria-hidden="true">${pointed}</div>`}
    <button class="plain save" onClick=${save} aria-label="save the plot as PNG" title="save as PNG">PNG</button></div>`;
}

/** Write the names of lines at their ends, the focused one first; none over another. */
function nameEnds(plot, names, focus) {
  const { ctx, bbox, data } = plot, ratio = devicePixelRatio, taken = [];
  const order = names.map((_, i) => i + 1).sort((a, b) => (b === focus) - (a === focus));
  ctx.save();
  ctx.font = `${11 * ratio}px ${style("--sans")}`;
  ctx.textAlign = "right";
  ctx.lineWidth = 3 * ratio;
  ctx.strokeStyle = style("--surface");
  for (const i of order) {
    const last = data[i].findLastIndex((value) => value != null);
    if (last < 0) continue;
    const wide = ctx.measureText(names[i - 1]).width, gap = 4 * ratio;
    const x = Math.max(bbox.left + wide, plot.valToPos(data[0][last], "x", true));
    const above = plot.valToPos(data[i][last], "y", true) - gap;
    const y = Math.max(bbox.top + 10 * ratio, above);
    if (taken.some((other) => Math.abs(other.y - y) < 12 * ratio && Math.abs(other.x - x) < wide + other.wide)) continue;
    taken.push({ x, y, wide });
    ctx.strokeText(names[i - 1], x, y);
    ctx.fillStyle = style(i === focus ? "--accent" : "--muted");
    ctx.fillText(names[i - 1], x, y);
  }
  ctx.restore();
}

/** The name, value and time of the line that is nearest to the pointer. */
function nearest(plot, names) {
  const { top, idxs } = plot.cursor;
  if (top < 0 || !idxs) return null;
  const away = (i) => Math.abs(plot.valToPos(plot.data[i][idxs[i]], "y") - top);
  const [i] = names.map((_, at) => at + 1).filter((at) => plot.data[at]?.[idxs[at]] != null).sort((a, b) => away(a) - away(b));
  return i === undefined ? null : `${names[i - 1]} ${value(plot.data[i][idxs[i]])} at ${stamp(1000 * plot.data[0][idxs[i]])}`;
}

const TWO_DAYS = 172_800;
/** Times of day; over several days the days. */
const timeLabels = (_, ticks) => ticks.map((t) =>
  (ticks.at(-1) - ticks[0] > TWO_DAYS ? day(t * 1000) : clock(t * 1000)));

function options(number, focus, zero) {
  const font = `11px ${style("--sans")}`;
  const axis = {
    stroke: style("--faint"), font, grid: { stroke: style("--line"), width: 1 },
    ticks: { show: false }, gap: 6,
  };
  const line = (i) => ({
    stroke: i === focus ? style("--accent") : style("--ghost"),
    width: i === focus ? 1.75 : 1, points: { show: false },
  });
  const fromZero = { range: (_, low, high) => [0, Math.max(1, high * 1.1)] };
  return {
    legend: { show: false }, padding: [10, 12, 0, 0], cursor: { y: false, points: { size: 5 } },
    scales: { x: { time: true }, ...(zero ? { y: fromZero } : {}) },
    axes: [
      { ...axis, size: 28, space: 70, values: timeLabels },
      { ...axis, size: 52, values: (_, ticks) => ticks.map(decimal) },
    ],
    series: [{}, ...Array.from({ length: number - 1 }, (_, i) => line(i + 1))],
  };
}

/** The arrays that uPlot draws: the values of each line at all times. Nothing at a time that a line
    lacks, and null (a gap) where it has nothing for longer than `gap` seconds and `PAUSE` of its
    steps: at all times there, since uPlot ends a gap at the first time without null. */
export function aligned(lines, gap = 5) {
  const limits = lines.map((line) => Math.max(gap, PAUSE * usualStep(line)));
  const isGap = (line, i, limit) => i > 0 && line[i][0] - line[i - 1][0] > limit;
  // A gap needs a time of its own: other lines may have none there.
  const all = lines.flatMap((line, n) => line.flatMap(([time], i) =>
    isGap(line, i, limits[n]) ? [(line[i - 1][0] + time) / 2, time] : [time]));
  const times = [...new Set(all)].sort((a, b) => a - b);
  const index = new Map(times.map((time, i) => [time, i]));
  return [times, ...lines.map((line, n) => {
    const row = new Array(times.length);
    line.forEach(([time, value], i) => {
      const at = index.get(time);
      if (isGap(line, i, limits[n])) row.fill(null, index.get(line[i - 1][0]) + 1, at);
      row[at] = value;
    });
    return row;
  })];
}

const PAUSE = 3;

/** The median time between two points of a line; 0 if there is one. */
function usualStep(line) {
  const steps = line.slice(1).map(([time], i) => time - line[i][0]).sort((a, b) => a - b);
  return steps[(steps.length - 1) >> 1] ?? 0;
}

const ROW = 26, BEYOND = 4;

/** A list of which only the visible rows are in the document. `scrolled(isAway)` is called when the
    reader leaves the top, and when they return. */
export function Rows({ items, draw, label, scrolled = () => {} }) {
  const box = useRef(), away = useRef(false);
  const [view, setView] = useState({ top: 0, room: 600 });
  useLayoutEffect(() => {
    const element = box.current;
    const read = () => {
      setView({ top: element.scrollTop, room: element.clientHeight });
      const isAway = element.scrollTop > ROW;
      if (isAway !== away.current) scrolled((away.current = isAway));
    };
    const watch = new ResizeObserver(read);
    watch.observe(element);
    element.addEventListener("scroll", read, { passive: true });
    return () => {
      watch.disconnect();
      element.removeEventListener("scroll", read);
    };
  }, []);
  const from = Math.max(0, Math.floor(view.top / ROW) - BEYOND);
  const until = Math.min(items.length, from + Math.ceil(view.room / ROW) + 2 * BEYOND);
  return html`<div class="scroll" ref=${box} tabindex="0" role="log" aria-label=${label} aria-live="off">
    <div class="rows" style=${{ height: `${items.length * ROW}px` }}>
      ${items.slice(from, until).map((item, i) => draw(item, { top: `${(from + i) * ROW}px` }))}
    </div></div>`;
}
