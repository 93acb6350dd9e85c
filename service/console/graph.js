// The stream graph as nodes and edges. Pure functions: node tests them without a browser.

const FOLDED = 6, WIDTH = 184, HEIGHT = 44, UNIT_WIDTH = 160, UNIT_HEIGHT = 28;

/** Nodes and edges of streams and units.

    A unit makes at most one stream, so it is drawn as a part of that stream; `apart` draws it by
    itself. `fold`: ends of one transformation over the same inputs are one stack. `only`: the chain of
    one node. A node is {id, kind, stream | unit, w, h, unit, requests, stack}; an edge is
    [from, to, stream]. */
export function model(streams, units, requests, { only = null, fold = true, apart = false } = {}) {
  const makers = new Map(units.map((unit) => [unit.output, unit]));
  const asked = Map.groupBy(requests, (request) => request.stream);
  const stacks = fold ? stacked(units) : new Map();
  const nodes = new Map(), edges = [];
  for (const { name } of streams) {
    if (name === "status" || stacks.has(name)) continue;
    nodes.set(name, {
      id: name, kind: "stream", stream: name, w: WIDTH, h: HEIGHT, unit: makers.get(name), requests: asked.get(name) ?? [],
    });
  }
  for (const unit of units) {
    const stack = stacks.get(unit.output);
    let id = unit.output;
    if (stack) {
      id = `stack ${stack[0].output}`;
      if (nodes.has(id)) continue;
      nodes.set(id, { id, kind: "stack", unit, stack, w: WIDTH, h: HEIGHT, requests: [] });
    } else if (apart || !nodes.has(id)) {
      id = `unit ${unit.name}`;
      nodes.set(id, { id, kind: "unit", unit, w: UNIT_WIDTH, h: UNIT_HEIGHT, requests: [] });
      if (nodes.has(unit.output)) edges.push([id, unit.output, unit.output]);
    }
    for (const input of new Set(unit.inputs)) if (nodes.has(input)) edges.push([input, id, input]);
  }
  if (only === null || !nodes.has(only)) return { nodes: [...nodes.values()], edges };
  const kept = chain(only, edges);
  return {
    nodes: [...nodes.values()].filter((node) => kept.has(node.id)),
    edges: edges.filter(([from, to]) => kept.has(from) && kept.has(to)),
  };
}

/** Output → the units that are drawn with it as one stack. */
function stacked(units) {
  const read = new Set(units.flatMap((unit) => unit.inputs));
  const ends = units.filter((unit) => !read.has(unit.output));
  const alike = Map.groupBy(ends, (unit) => JSON.stringify([unit.transformation, [...unit.inputs].sort()]));
  const stacks = new Map();
  for (const group of alike.values()) {
    if (group.length > FOLDED) for (const unit of group) stacks.set(unit.output, group);
  }
  return stacks;
}

/** The nodes that `id` reaches along edges (side 1) or against them (side 0), without itself. */
export function reached(id, edges, side) {
  const next = Map.groupBy(edges, (edge) => edge[1 - side]);
  const found = new Set(), waiting = [id];
  while (waiting.length) {
    for (const edge of next.get(waiting.pop()) ?? []) {
      if (found.has(edge[side])) continue;
      found.add(edge[side]);
      waiting.push(edge[side]);
    }
  }
  found.delete(id);
  return found;
}

/** A node with all that feeds it and all that it feeds. */
export const chain = (id, edges) => new Set([id, ...reached(id, edges, 0), ...reached(id, edges, 1)]);
