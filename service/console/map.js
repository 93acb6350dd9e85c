// A map without tiles: a graticule, a scale, and objects with their trails. Objects of recent events
// are in the accent colour.
import { html, useEffect, useRef } from "./vendor/preact.js";
import { shown, tick } from "./feed.js";
import { penOf, style, theme } from "./widgets.js";

const HOT = 10_000, GONE = 120_000, TRAIL = 90_000, JUMP = 0.05, NEAR = 14, DEGREE_KM = 111.2;

/** 1, 2 or 5 times a power of ten, at most `size`. */
const round = (size) => {
  const power = 10 ** Math.floor(Math.log10(size)), first = size / power;
  return (first < 2 ? 1 : first < 5 ? 2 : 5) * power;
};
const degrees = (value, [plus, minus]) => `${Number(Math.abs(value).toFixed(4))}° ${value < 0 ? minus : plus}`;

class Drawing {
  spots = [];
  view = { auto: true, x: 0, y: 0, scale: 1, narrow: 1 };

  constructor(canvas) {
    this.canvas = canvas;
  }

  x = (longitude) => this.width / 2 + (longitude - this.view.x) * this.view.narrow * this.view.scale;
  y = (latitude) => this.height / 2 - (latitude - this.view.y) * this.view.scale;

  draw(rings, selected, isWanted) {
    const { canvas } = this;
    if (!canvas.clientWidth) return;
    [this.width, this.height] = [canvas.clientWidth, canvas.clientHeight];
    this.pen = penOf(canvas);
    this.colours = Object.fromEntries(
      ["line", "faint", "ghost", "muted", "accent", "surface", "text"].map((name) => [name, style(`--${name}`)]));
    this.font = style("--sans");
    const all = [...rings.tracks].filter(([, track]) => track.points.length);
    if (!all.length) return;
    const newest = Math.max(...all.map(([, track]) => track.points.at(-1)[2]));
    const present = all.filter(([, track]) => newest - track.points.at(-1)[2] <= GONE);
    if (this.view.auto) this.fit(present.map(([, track]) => track.points.at(-1)));
    this.grid();
    this.spots = [];
    this.labels = [];
    const isHot = (name) => [...(rings.hot.get(name) ?? [])]
      .some(([stream, time]) => isWanted(stream) && newest - time < HOT);
    for (const [name, track] of present) {
      const isSelected = name === selected;
      this.object(name, track, isHot(name) || isSelected, isSelected, present.length < 400);
    }
  }

  fit(points) {
    const bounds = (k) => [Math.min(...points.map((p) => p[k])), Math.max(...points.map((p) => p[k]))];
    const [west, east] = bounds(0), [south, north] = bounds(1), view = this.view;
    [view.x, view.y] = [(west + east) / 2, (south + north) / 2];
    view.narrow = Math.max(0.01, Math.cos((view.y * Math.PI) / 180));
    const wide = Math.max(east - west, 0.02) * view.narrow, high = Math.max(north - south, 0.02);
    view.scale = 0.86 * Math.min(this.width / wide, this.height / high);
  }

  grid() {
    const { pen, view, colours } = this, step = round(150 / view.scale);
    pen.font = `10px ${this.font}`;
    pen.lineWidth = 1;
    pen.strokeStyle = colours.line;
    pen.fillStyle = colours.faint;
    const line = (x1, y1, x2, y2) => {
      pen.beginPath();
      pen.moveTo(x1, y1);
      pen.lineTo(x2, y2);
      pen.stroke();
    };
    const across = this.width / 2 / view.scale / view.narrow, up = this.height / 2 / view.scale;
    for (let at = Math.ceil((view.x - across) / step) * step; at < view.x + across; at += step) {
      const x = Math.round(this.x(at)) + 0.5;
      line(x, 0, x, this.height);
      pen.fillText(degrees(at, "EW"), x + 4, 12);
    }
    for (let at = Math.ceil((view.y - up) / step) * step; at < view.y + up; at += step) {
      const y = Math.round(this.y(at)) + 0.5;
      line(0, y, this.width, y);
      pen.fillText(degrees(at, "NS"), 4, y - 4);
    }
    const km = round((90 / view.scale) * DEGREE_KM), bar = (km / DEGREE_KM) * view.scale, y = this.height - 8;
    pen.strokeStyle = colours.muted;
    line(8, y, 8 + bar, y);
    line(8, y - 4, 8, y);
    line(8 + bar, y - 4, 8 + bar, y);
    pen.fillText(km >= 1 ? `${km} km` : `${Math.round(km * 1000)} m`, 14 + bar, y);
  }

  object(name, track, isOn, isSelected, labelled) {
    const { pen, colours } = this, end = track.points.at(-1), x = this.x(end[0]), y = this.y(end[1]);
    this.trail(track.points, isOn ? colours.accent : colours.ghost);
    pen.fillStyle = isOn ? colours.accent : colours.muted;
    pen.beginPath();
    if (track.heading == null) {
      pen.arc(x, y, isOn ? 4 : 3, 0, 7);
    } else {
      const angle = (track.heading * Math.PI) / 180, size = isOn ? 6 : 4.5;
      const corner = (turn) => [x + Math.sin(angle + turn) * size, y - Math.cos(angle + turn) * size];
      pen.moveTo(...corner(0));
      pen.lineTo(...corner(2.5));
      pen.lineTo(...corner(-2.5));
      pen.closePath();
    }
    pen.fill();
    this.spots.push([x, y, name]);
    if (isSelected) {
      pen.strokeStyle = colours.accent;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(x, y, 10, 0, 7);
      pen.stroke();
    }
    if (isSelected || (isOn && labelled)) this.label(track.values.callsign || String(name), x, y, isSelected);
  }

  trail(points, colour) {
    const { pen } = this, end = points.at(-1);
    pen.strokeStyle = colour;
    pen.globalAlpha = 0.75;
    pen.lineWidth = 1;
    pen.beginPath();
    let last = null;
    for (const point of points) {
      if (end[2] - point[2] > TRAIL) continue;
      const isJump = last && Math.hypot(point[0] - last[0], point[1] - last[1]) > JUMP;
      if (last && !isJump) pen.lineTo(this.x(point[0]), this.y(point[1]));
      else pen.moveTo(this.x(point[0]), this.y(point[1]));
      last = point;
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  label(text, x, y, isSelected) {
    const { pen, colours } = this;
    pen.font = `${isSelected ? 600 : 400} 11px ${this.font}`;
    const wide = pen.measureText(text).width + 9;
    const left = x + 9 + wide > this.width ? x - wide - 4 : x + 9; // inside at the right edge, too
    const box = [left, y - 7, left + wide, y + 7];
    const overlaps = (other) => other[0] < box[2] && box[0] < other[2] && other[1] < box[3] && box[1] < other[3];
    if (!isSelected && this.labels.some(overlaps)) return;
    this.labels.push(box);
    pen.lineWidth = 3;
    pen.strokeStyle = colours.surface;
    pen.strokeText(text, left, y + 4);
    pen.fillStyle = isSelected ? colours.accent : colours.text;
    pen.fillText(text, left, y + 4);
  }

  zoom(factor, x, y) {
    const view = this.view, dx = x - this.width / 2, dy = y - this.height / 2;
    const longitude = view.x + dx / view.narrow / view.scale, latitude = view.y - dy / view.scale;
    view.auto = false;
    view.scale *= factor;
    view.x = longitude - dx / view.narrow / view.scale;
    view.y = latitude + dy / view.scale;
  }

  pan(dx, dy) {
    this.view.auto = false;
    this.view.x -= dx / this.view.narrow / this.view.scale;
    this.view.y += dy / this.view.scale;
  }

  at(x, y) {
    const near = this.spots.map(([a, b, name]) => [Math.hypot(a - x, b - y), name]).sort((a, b) => a[0] - b[0])[0];
    return near && near[0] < NEAR ? near[1] : null;
  }
}

/** The map. `isWanted(stream)`: whether events of the stream colour their objects. */
export function TrackMap({ selected, select, isWanted }) {
  const canvas = useRef(), drawing = useRef(), now = useRef();
  now.current = { select, draw: () => drawing.current?.draw(shown.value, selected, isWanted) };
  useEffect(() => {
    drawing.current = new Drawing(canvas.current);
    const watch = new ResizeObserver(() => now.current.draw());
    watch.observe(canvas.current);
    handle(canvas.current, drawing.current, now);
    return () => watch.disconnect();
  }, []);
  useEffect(() => now.current.draw(), [tick.value, shown.value, selected, theme.value]);
  const fit = () => {
    drawing.current.view.auto = true;
    now.current.draw();
  };
  return html`<canvas ref=${canvas} role="img" aria-label="map of objects"></canvas>
    <div class="over"><button onClick=${fit}>Fit</button></div>`;
}

/** Zoom by wheel and two fingers, pan by one, choose by a click. */
function handle(canvas, drawing, now) {
  const fingers = new Map();
  let moved = 0;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    drawing.zoom(Math.exp(-event.deltaY * 0.002), event.offsetX, event.offsetY);
    now.current.draw();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const was = fingers.get(event.pointerId);
    if (!was) return;
    const [x, y] = [event.offsetX, event.offsetY];
    moved += Math.abs(x - was[0]) + Math.abs(y - was[1]);
    const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const far = (a) => Math.max(1, Math.hypot(a[0] - other[0], a[1] - other[1]));
      drawing.zoom(far([x, y]) / far(was), other[0], other[1]);
    } else if (moved > 3) drawing.pan(x - was[0], y - was[1]);
    fingers.set(event.pointerId, [x, y]);
    now.current.draw();
  });
  const up = (event) => {
    fingers.delete(event.pointerId);
    if (moved <= 3) now.current.select(drawing.at(event.offsetX, event.offsetY));
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
}
