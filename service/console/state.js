// What the page knows of the service, as signals. It polls the small answers, and asks for the
// structure again when /status/events reports a change.
import { batch, computed, signal } from "./vendor/preact.js";
import { address, ask, follow } from "./http.js";
import { local, unit, words } from "./format.js";

export const status = signal(null), streams = signal([]), units = signal([]), problems = signal([]);
export const requests = signal([]), templates = signal([]), transformations = signal([]);
export const vocabulary = signal({ sorts: [], features: [], events: [], prefixes: {} });
/** Whether requests, templates and the vocabulary have been read once: until then none is known. */
export const isKnown = signal(false);
export const session = signal({ required: false, scopes: [] });
/** connecting, open, waiting (no answer) or login. */
export const connection = signal("connecting");
export const changes = signal([]);
/** Rates and load at each poll, oldest first: at most an hour of them. */
export const history = signal([]);
export const held = signal(false);
/** The time (ms) that is played back; null: the present. */
export const moment = signal(null);

const POLL = 2_000, SLOW_POLL = 10_000, MANY = 200, KEPT = 1_800, CHANGES = 500;

export const byName = computed(() => new Map(streams.value.map((each) => [each.name, each])));
export const makers = computed(() => new Map(units.value.map((each) => [each.output, each])));
export const featureOf = computed(
  () => new Map(vocabulary.value.features.map((each) => [local(each.name), each])));
/** Stream → the request that it answers. Where there are several, a query before a subscription. */
export const asked = computed(
  () => new Map(requests.value.toReversed().map((each) => [each.stream, each])));
/** What a request gives: verdicts of a MONITOR, matches of a PATTERN, or results of a query. */
export const MONITOR = "MONITOR", PATTERN = "PATTERN";
/** The fields that say what a verdict or a match is; none names an object. */
const TOLD = { [MONITOR]: ["verdict", "decided", "witness", "last"], [PATTERN]: ["start", "end"] };
export const told = (stream) => TOLD[asked.value.get(stream)?.gives] ?? [];
export const may = (scope) => !session.value.required || session.value.scopes.includes(scope)
  || session.value.scopes.includes("admin");

/** What the page reports as wrong: the service's findings, or that there is no connection. */
export const wrong = computed(() => connection.value === "waiting"
  ? [{ level: "bad", what: "No connection", detail: "The page shows what was before.", hint: "It tries again.", kind: "service" }]
  : problems.value);

// -- what a stream means ---------------------------------------------------------------------------

/** The meaning of a stream in a few words, else its name. */
export function title(stream) {
  const names = [...new Set(stream.ports.map((port) => local(port.feature)))];
  if (!names.length) return stream.name;
  const sort = stream.ports[0].of[0]?.name;
  return sort ? `${names.join(", ")} of ${local(sort)}` : names.join(", ");
}

/** The field that names the object of a sample. */
export function objectField(stream) {
  const named = stream.ports.flatMap((port) => port.of).find((each) => each.id);
  const isName = (field) => field.type === "string" && !told(stream.name).includes(field.name);
  return named?.id ?? stream.fields.find(isName)?.name;
}

/** The unit of a field, from its annotation; in a query's results that of the feature it is
    called after. */
export function unitOf(stream, field) {
  const written = stream.ports.find((port) => port.field === field)?.unit;
  const known = stream.producer ? featureOf.value.get(field)?.unit : null;
  return unit(written || known);
}

/** The fields with an object's position; null if the stream has none. */
export function place(stream) {
  const field = (name) => stream.ports.find((port) => local(port.feature) === name)?.field;
  const [latitude, longitude] = [field("latitude"), field("longitude")];
  if (!latitude || !longitude) return null;
  const own = (name) => stream.fields.find((each) => each.name === name)?.name;
  return { latitude, longitude, heading: field("heading") ?? own("heading") ?? own("track") };
}

export const numbers = (stream) =>
  stream.fields.filter((each) => ["float", "integer"].includes(each.type)).map((each) => each.name);

/** Seconds since the last sample; negative for one in the future. A stream's own `lag` is how late
    that sample came. */
export const silence = (stream) => stream.last_available && status.value
  ? (Date.parse(status.value.now) - Date.parse(stream.last_available)) / 1000 : null;

// -- polling -----------------------------------------------------------------------------------------

function rateOf(list) {
  return list.reduce((sum, stream) => sum + (stream?.rate ?? 0), 0);
}

/** The streams that have ended: the states of requests follow them. */
const endedOf = (list) => list.filter((each) => each.ended).map((each) => each.name).join();

async function look() {
  try {
    const [now, list, running, found] = await Promise.all(
      ["/status", "/streams", "/units", "/problems"].map((path) => ask(path)));
    batch(() => {
      if (endedOf(list) !== endedOf(streams.value)) refreshSoon();
      status.value = now;
      streams.value = list;
      units.value = running;
      problems.value = found;
      connection.value = "open";
      const inward = list.filter((each) => !each.producer && each.name !== "status");
      const outward = requests.value.map((each) => byName.value.get(each.stream));
      history.value = [...history.value.slice(1 - KEPT), {
        time: Date.now() / 1000, in: rateOf(inward), out: rateOf(outward), ...now.load,
      }];
    });
  } catch (error) {
    connection.value = error.status === 401 || error.status === 403 ? "login" : "waiting";
  }
}

/** `again(since)`: the route, type and body that ask for the same once more, from then on. */
const request = (kind, name, more) => ({ kind, name, chips: [], problem: null, ...more });

function eventRequest(one) {
  const terms = one.arguments.map((each) => (each.startsWith("?") ? "any" : local(each)));
  return request("event", words(one.event), {
    id: one.id, stream: one.stream, state: one.state, problem: one.failure, chips: terms,
    empty: one.empty, event: one.event, gives: one.kind, plan: one.plan, address: `/events/${one.id}`,
    again: (since = one.since) =>
      ({ path: "/events", body: { event: one.event, arguments: one.arguments, strategy: one.strategy, since } }),
  });
}

function queryRequest(one) {
  return request("query", one.name, {
    id: one.name, stream: one.stream, state: one.state, problem: one.failure, empty: one.empty,
    chips: [one.form || one.dialect], source: one.source, plan: one.plan, dialect: one.dialect,
    form: one.form, gives: one.kind, address: `/queries/${encodeURIComponent(one.name)}`,
    again: (since = one.options.since) =>
      ({ path: address("/queries", { ...one.options, since }), type: "text/plain", body: one.source }),
  });
}

/** The body of a subscription like this one. */
function subscriptionBody({ source, policy, adaptive }, since) {
  if (!adaptive) return { stream: source, policy, since };
  const { feature, sort, objects, strategy, staleness, min_quality, hold_off } = adaptive;
  return { feature, objects, strategy, policy, since, min_quality, hold_off, ...(sort && { sort }), ...(staleness && { staleness }) };
}

function subscriptionRequest(one) {
  const want = one.adaptive && `${local(one.adaptive.feature)} of ${one.adaptive.objects.length
    ? one.adaptive.objects.map(local).join(" and ") : `every ${local(one.adaptive.sort ?? "Thing")}`}`;
  return request("subscription", want ?? one.source, {
    id: one.id, stream: one.stream, state: one.state === "running" ? one.adaptive?.state ?? one.state : one.state,
    problem: one.failure ?? one.adaptive?.missing.join("; ") ?? null, adaptive: one.adaptive,
    chips: one.policy ? [one.policy] : [], address: `/subscriptions/${one.id}`,
    again: (since = one.since) => ({ path: "/subscriptions", body: subscriptionBody(one, since) }),
  });
}

export async function refresh() {
  const [events, queries, subscriptions, known, made, names] = await Promise.all([
    "/events", "/queries", "/subscriptions", "/templates", "/transformations", "/vocabulary",
  ].map((path) => ask(path)));
  batch(() => {
    requests.value = [
      ...events.map(eventRequest), ...queries.map(queryRequest),
      ...subscriptions.map(subscriptionRequest),
    ];
    templates.value = known;
    transformations.value = made;
    vocabulary.value = names;
    isKnown.value = true;
  });
}

let due = 0, begun = false;
const refreshSoon = () => {
  clearTimeout(due);
  due = setTimeout(() => refresh().catch(() => {}), 300);
};

function note(messages) {
  const found = messages.filter((each) => each.event === "sample")
    .map((each) => ({ time: each.available, sequence: each.sequence, ...each.values }));
  changes.value = [...changes.value, ...found].slice(-CHANGES);
  refreshSoon();
}

/** Begin to poll and to follow; after a login once more. */
export async function start() {
  session.value = await ask("/session").catch(() => ({ required: true, scopes: [] }));
  if (session.value.required && !session.value.name) {
    connection.value = "login";
    return;
  }
  connection.value = "connecting";
  if (begun) return;
  begun = true;
  const again = async () => {
    if (!document.hidden) await look();
    setTimeout(again, streams.value.length > MANY ? SLOW_POLL : POLL);
  };
  again();
  refreshSoon();
  follow("/status/events?since=start&rdf=no", note);
}
