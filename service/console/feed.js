// The samples that arrive, kept outside of any page. Messages only fill these rings; drawing looks
// at them four times a second, however many arrive.
import { effect, signal } from "./vendor/preact.js";
import { address, ask, follow } from "./http.js";
import { byName, held, moment, objectField, place, requests, streams } from "./state.js";

const EVENTS = 2_000, POINTS = 600, OBJECTS = 200, TRACKS = 5_000, TRACK_POINTS = 120;
const TICK = 250, NEWEST = `${TICK}ms`, MOST_STREAMS = 50, PAST_EVENTS = 60, PAST_POSITIONS = 3_000;
const MOST_PLOTTED = 10_000, INTERVALS = 300;
const SLOW = 50, SLOW_FOR = 3_000;
const PLAYED_PAST = 120_000, FAST = 5_000, LEAST = 0.05;

/** The newest samples in the shapes that pages draw. */
export class Rings {
  events = [];
  /** Stream → its newest event. */
  last = new Map();
  /** Stream → object → its events, oldest first. */
  series = new Map();
  /** Object → {points: [longitude, latitude, time][], heading, values}. */
  tracks = new Map();
  /** Object → stream of a request → the time of its last event. */
  hot = new Map();
  total = 0;

  note(name, valid, values) {
    const stream = byName.value.get(name);
    if (!stream) return;
    const time = Date.parse(valid), id = objectField(stream), object = id ? values[id] : null;
    const spot = place(stream);
    if (spot && object != null && values[spot.latitude] != null) this.#track(object, spot, time, values);
    const isAsked = requests.value.some((request) => request.stream === name);
    if (!isAsked && extra.value !== name) return;
    const event = { time, valid, name, object, values, number: this.total++ };
    this.events.push(event);
    if (this.events.length > 1.5 * EVENTS) this.events.splice(0, this.events.length - EVENTS);
    this.last.set(name, event);
    if (isAsked && object != null) within(this.hot, object, () => new Map()).set(name, time);
    const lines = within(this.series, name, () => new Map());
    if (!lines.has(object) && lines.size >= OBJECTS) return;
    const line = within(lines, object, () => []);
    line.push(event);
    if (line.length > POINTS) line.splice(0, POINTS / 3);
  }

  gap(message) {
    this.events.push({ time: Date.now(), name: message.stream, gap: message, number: this.total++ });
  }

  #track(object, spot, time, values) {
    if (!this.tracks.has(object) && this.tracks.size >= TRACKS) return;
    const track = within(this.tracks, object, () => ({ points: [] }));
    track.points.push([values[spot.longitude], values[spot.latitude], time]);
    if (track.points.length > TRACK_POINTS) track.points.splice(0, TRACK_POINTS / 3);
    track.heading = spot.heading ? values[spot.heading] : null;
    track.values = values;
  }
}

function within(map, key, make) {
  if (!map.has(key)) map.set(key, make());
  return map.get(key);
}

const live = new Rings();
/** A stream that a page shows beside those of requests. */
export const extra = signal(null);
/** The rings that are shown, live or played back; a new `tick` says that they have changed. */
export const shown = signal(live);
export const tick = signal(0);
/** connecting; open, waiting or failed; ended, as the followed streams have. */
export const feedState = signal("connecting");
/** Whether of events only the newest of each object come, as the page cannot read all. */
export const isThinned = signal(false);
/** Samples a second that have arrived, and all so far. */
export const arrivals = signal({ rate: 0, total: 0 });

let dirty = false, before = 0, rate = 0;
setInterval(() => {
  rate = 0.7 * rate + (0.3 * (live.total - before) * 1000) / TICK;
  if (rate < LEAST) rate = 0;
  before = live.total;
  if (document.hidden) return;
  const isOther = Math.abs(rate - arrivals.value.rate) > LEAST || (!rate && arrivals.value.rate);
  if (isOther || held.value) arrivals.value = { rate, total: live.total };
  if (dirty && !held.value && moment.value === null) {
    dirty = false;
    tick.value++;
  }
}, TICK);

// ISO times of different lengths compare as texts without their Z.
const isLater = (time, end) => !end || time.slice(0, -1) > end.slice(0, -1);

/** Messages of streams whose past is being read: they are noted after it. */
const early = new Map();
/** The available time of the last sample of each stream. */
const latest = new Map();

function take(messages) {
  for (const each of messages) {
    if (each.event === "gap") {
      live.gap(each);
      epoch = null; // what comes is of another one, and the gap has said so
    } else if (each.event !== "sample") continue;
    else if (early.has(each.stream)) early.get(each.stream).push(each);
    else note(each);
  }
  dirty = true;
}

function note({ stream, available, valid, values }) {
  latest.set(stream, available);
  live.note(stream, valid, values);
}

const history = (name, bounds) => ask(address(`/streams/${encodeURIComponent(name)}/samples`, bounds));

/** The kept samples of streams, in the order of their valid times; `bounds` of a stream are the
    parameters of its history. */
async function kept(names, bounds) {
  const lists = await Promise.all(names.map(async (stream) => {
    const samples = await history(stream, bounds(stream)).catch(() => []);
    return samples.map(({ available, valid, ...values }) => ({ stream, available, valid, values }));
  }));
  return lists.flat().sort((a, b) => (isLater(a.valid, b.valid) ? 1 : -1));
}

let epoch = null;
/** Show a gap where the service has begun anew; `position` is that of a new connection. */
function noteEpoch(position) {
  const now = position.slice(0, position.lastIndexOf("-"));
  if (epoch !== null && now !== epoch) live.gap({ detail: "the service has begun anew" });
  epoch = now;
}

/** Show what streams had before a connection that has begun, each sample once: the past of those
    that were not followed, and of others what came since their last one. False if meanwhile another
    connection has begun, so that it is not `isNewest`. */
async function begin(names, isNewest) {
  const known = new Map(latest);
  const past = await kept(names, (name) => {
    if (known.has(name)) return { from: known.get(name) };
    return { limit: place(byName.value.get(name)) ? PAST_POSITIONS : PAST_EVENTS };
  });
  if (!isNewest()) return false; // the other connection reads the same again
  for (const each of past) if (isLater(each.available, known.get(each.stream))) note(each);
  const ends = new Map();
  for (const { stream, available } of past) {
    if (isLater(available, ends.get(stream))) ends.set(stream, available);
  }
  for (const name of names) {
    const messages = early.get(name);
    early.delete(name);
    take(messages.filter((each) => isLater(each.available, ends.get(name) ?? known.get(name))));
  }
  dirty = true;
  return true;
}

// -- which streams are followed ----------------------------------------------------------------------

/** The streams whose samples are shown from their past on. */
export const following = signal([]);

const STATES = ["failed", "waiting", "connecting", "open", "ended"];

/** A connection that follows streams. Nothing here shows their RDF. */
class Connection {
  names = [];
  /** The streams whose past has been read. */
  ready = [];
  /** One of `STATES`; null if it follows none. */
  state = null;
  #number = 0;
  #stop = null;
  /** Since when each chunk has taken the page long; null: the last one has not. */
  #slowSince = null;

  constructor(parameters) {
    this.parameters = { ...parameters, rdf: "no" };
  }

  follow(names) {
    const goesOn = this.state === "ended" && names.some((name) => !byName.value.get(name).ended);
    if (names.join() !== this.names.join() || goesOn) this.#connect(names);
  }

  #connect(names) {
    this.names = names;
    this.#stop?.();
    this.#stop = null;
    this.#number++;
    this.ready = this.ready.filter((name) => names.includes(name));
    this.#tell(names.length ? "connecting" : null);
    if (!names.length) return;
    const path = address("/follow", { stream: names, ...this.parameters });
    this.#stop = follow(path, (messages, begun) => {
      take(messages);
      this.#measure(begun);
    }, (state, position) => {
      this.#tell(state);
      if (!position) return;
      noteEpoch(position);
      // What comes from here on is sent; what came before is read.
      for (const name of names) early.set(name, []);
      const own = ++this.#number;
      begin(names, () => own === this.#number).then((isRead) => {
        if (!isRead) return;
        this.ready = names;
        following.value = [events, positions].flatMap((each) => each.ready);
      });
    }, names.length);
  }

  /** Ask for the newest of each object only, once the page has been too slow for all for a while. */
  #measure(begun) {
    const now = performance.now();
    if (now - begun < SLOW) this.#slowSince = null;
    else this.#slowSince ??= begun;
    if (this.parameters.every || this.#slowSince === null || now - this.#slowSince < SLOW_FOR) return;
    this.parameters.every = NEWEST;
    isThinned.value = true;
    this.#connect(this.names);
  }

  /** Show the state that most needs attention. */
  #tell(state) {
    this.state = state;
    const states = [events.state, positions.state];
    feedState.value = STATES.find((each) => states.includes(each)) ?? "connecting";
  }
}

/** Pages list all events. Of positions the map draws the newest of each object, at each tick. */
const events = new Connection({}), positions = new Connection({ every: NEWEST });
const hasObjects = (stream) => stream.ports.some((port) => port.of.some((each) => each.id));
effect(() => {
  if (!streams.value.length) return;
  const all = new Set([...requests.value.map((request) => request.stream), extra.value]);
  const newest = new Set();
  for (const stream of streams.value) {
    if (stream.producer || stream.rate >= FAST || !place(stream) || all.has(stream.name)) continue;
    (hasObjects(stream) ? newest : all).add(stream.name);
  }
  const wanted = (names) =>
    [...names].filter((name) => byName.value.has(name)).sort().slice(0, MOST_STREAMS);
  positions.follow(wanted(newest));
  events.follow(wanted(all));
});

// -- playback ----------------------------------------------------------------------------------------

let wish = 0;
const followed = () => [...events.names, ...positions.names];
/** The valid time (ms) of the oldest kept sample of a stream; null: it has none. */
async function oldestOf(name) {
  const from = byName.value.get(name)?.first_available;
  if (!from) return null;
  const [first] = await history(name, { from, limit: 1 }).catch(() => []);
  return first ? Date.parse(first.valid) : null;
}

/** The valid time (ms) of the oldest kept sample of the streams that are followed; null: there is none. */
export async function oldest() {
  const times = (await Promise.all(followed().map(oldestOf))).filter((time) => time !== null);
  return times.length ? Math.min(...times) : null;
}

/** The valid time (ms) of the newest sample of the streams that are followed. */
export function newest() {
  const times = followed().map((name) => byName.value.get(name)?.last_valid).filter(Boolean);
  return times.length ? Math.max(...times.map((time) => Date.parse(time))) : Date.now();
}

/** The kept history of a field: lines [object, [time in s, value][]], the most recent first. Where there
    are many samples, the last of each object and interval. */
export async function past(stream, field) {
  const id = objectField(stream), first = await oldestOf(stream.name);
  if (first === null) return [];
  const span = Date.parse(stream.last_valid) - first;
  const isKeyed = !id || stream.ports.some((port) => port.of.some((each) => each.id === id));
  const every = stream.kept > MOST_PLOTTED && isKeyed ? `${Math.ceil(span / INTERVALS) || 1}ms` : null;
  const fields = [id, field].filter(Boolean).join(",");
  const samples = await history(stream.name, { fields, every, limit: MOST_PLOTTED });
  const lines = Map.groupBy(samples.sort((a, b) => (isLater(a.valid, b.valid) ? 1 : -1)), (each) => (id ? each[id] : ""));
  return [...lines].map(([name, rows]) => [name, rows.map((each) => [Date.parse(each.valid) / 1000, each[field]])])
    .sort((a, b) => b[1].at(-1)[0] - a[1].at(-1)[0]);
}

/** Show how it was at `time` (ms), or the present again for null. */
export async function play(time) {
  moment.value = time;
  const own = ++wish;
  if (time === null) {
    shown.value = live;
    tick.value++;
    return;
  }
  const rings = new Rings(), iso = (at) => new Date(at).toISOString();
  const bounds = { valid_from: iso(time - PLAYED_PAST), valid_to: iso(time), limit: PAST_POSITIONS };
  const samples = await kept(followed(), () => bounds);
  if (own !== wish) return; // another time has been chosen since
  for (const each of samples) rings.note(each.stream, each.valid, each.values);
  shown.value = rings;
  tick.value++;
}
