// A layered layout (Sugiyama): layers by longest path, dummies for long edges, median sweeps, then
// places that keep the order. Pure functions: node tests them without a browser.

const SWEEPS = 8, PULLS = 10;

/** Place `nodes` [{id, w, h}] with `edges` [[from, to]] from left to right.

    Returns places (Map id → {x, y, layer}; y is the middle), paths (points of each edge), and the
    width and height of all. Cost: about linear in nodes and edges. */
export function layout(nodes, edges, { layerGap = 56, nodeGap = 14 } = {}) {
  const index = new Map(nodes.map((node, i) => [node.id, i]));
  const links = edges.map(([from, to]) => [index.get(from), index.get(to)]);
  const layerOf = layersOf(nodes.length, links);
  const { all, chains } = withDummies(nodes, links, layerOf);
  const layers = order(all);
  const size = spread(all, layers, layerGap, nodeGap);
  const at = (i) => all[i];
  const paths = chains.map((chain) => chain.length < 2 ? [] : chain.flatMap((i, k) => {
    const points = [];
    if (k > 0) points.push([at(i).x, at(i).y]);
    if (k < chain.length - 1) points.push([at(i).x + at(i).w, at(i).y]);
    return points;
  }));
  const places = new Map(nodes.map((node, i) => [node.id, { x: all[i].x, y: all[i].y, w: node.w, layer: layerOf[i] }]));
  return { places, paths, ...size };
}

/** A smooth line through points, level at its ends. */
export function curve(points) {
  let path = `M${points[0][0]} ${points[0][1]}`;
  for (let i = 1; i < points.length; i++) {
    const [x1, y1] = points[i - 1], [x2, y2] = points[i], middle = (x1 + x2) / 2;
    path += `C${middle} ${y1} ${middle} ${y2} ${x2} ${y2}`;
  }
  return path;
}

/** The layer of each node: one after the last that it follows. A link that closes a cycle is turned
    around in place. */
function layersOf(n, links) {
  const out = Array.from({ length: n }, () => []);
  links.forEach(([from, to], i) => out[from].push([to, i]));
  const state = new Uint8Array(n), finished = [], turned = new Set();
  for (let root = 0; root < n; root++) {
    if (state[root]) continue;
    const stack = [[root, 0]];
    state[root] = 1;
    while (stack.length) {
      const top = stack.at(-1);
      if (top[1] === out[top[0]].length) {
        state[top[0]] = 2;
        finished.push(stack.pop()[0]);
        continue;
      }
      const [next, i] = out[top[0]][top[1]++];
      if (state[next] === 1) turned.add(i);
      else if (!state[next]) {
        state[next] = 1;
        stack.push([next, 0]);
      }
    }
  }
  for (const i of turned) links[i].reverse();
  const after = Array.from({ length: n }, () => []);
  for (const [from, to] of links) if (from !== to) after[from].push(to);
  const layer = new Int32Array(n);
  for (const v of finished.toReversed()) for (const w of after[v]) layer[w] = Math.max(layer[w], layer[v] + 1);
  // Sources stand beside what reads them, not all at the left.
  for (const v of finished) if (after[v].length) layer[v] = Math.max(layer[v], Math.min(...after[v].map((w) => layer[w])) - 1);
  return layer;
}

/** The nodes, and a dummy in each layer that an edge crosses; chains are the nodes of each edge. */
function withDummies(nodes, links, layer) {
  const all = nodes.map((node, i) => ({ w: node.w, h: node.h, layer: layer[i], up: [], down: [] }));
  const chains = links.map(([from, to]) => {
    if (from === to) return [];
    const chain = [from];
    for (let at = layer[from] + 1; at < layer[to]; at++) {
      chain.push(all.push({ w: 0, h: 6, layer: at, up: [], down: [] }) - 1);
    }
    chain.push(to);
    for (let k = 1; k < chain.length; k++) {
      all[chain[k - 1]].down.push(chain[k]);
      all[chain[k]].up.push(chain[k - 1]);
    }
    return chain;
  });
  return { all, chains };
}

/** The layers with their nodes in an order with few crossings. */
function order(all) {
  const layers = Array.from({ length: Math.max(0, ...all.map((node) => node.layer + 1)) }, () => []);
  const seen = new Uint8Array(all.length);
  for (let root = 0; root < all.length; root++) { // as a walk meets them, so that components stay together
    const stack = [root];
    while (stack.length) {
      const v = stack.pop();
      if (seen[v]) continue;
      seen[v] = 1;
      layers[all[v].layer].push(v);
      stack.push(...all[v].up, ...all[v].down);
    }
  }
  const rank = new Float64Array(all.length);
  const number = (list) => list.forEach((v, k) => { rank[v] = k; });
  layers.forEach(number);
  const median = (list) => {
    const ranks = list.map((v) => rank[v]).sort((a, b) => a - b), half = ranks.length >> 1;
    return ranks.length % 2 ? ranks[half] : (ranks[half - 1] + ranks[half]) / 2;
  };
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    const side = sweep % 2 ? "down" : "up";
    for (const list of sweep % 2 ? layers.toReversed() : layers) {
      const key = new Map(list.map((v) => [v, all[v][side].length ? median(all[v][side]) : rank[v]]));
      list.sort((a, b) => key.get(a) - key.get(b) || rank[a] - rank[b]);
      number(list);
    }
  }
  return layers;
}

/** Give each node its place; return the width and height of all. */
function spread(all, layers, layerGap, nodeGap) {
  let x = 0;
  for (const list of layers) {
    let y = 0;
    for (const v of list) {
      [all[v].x, all[v].y] = [x, y + all[v].h / 2];
      y += all[v].h + nodeGap;
    }
    x += Math.max(0, ...list.map((v) => all[v].w)) + layerGap;
  }
  for (let pull = 0; pull < PULLS; pull++) {
    const side = pull % 2 ? "down" : "up";
    for (const list of pull % 2 ? layers.toReversed() : layers) {
      const near = (v) => pull < PULLS - 2 ? all[v][side] : [...all[v].up, ...all[v].down];
      const wish = list.map((v) => near(v).length ? near(v).reduce((sum, w) => sum + all[w].y, 0) / near(v).length : all[v].y);
      settle(list.map((v) => all[v]), wish, nodeGap);
    }
  }
  const top = Math.min(0, ...all.map((node) => node.y - node.h / 2));
  for (const node of all) node.y -= top;
  return { width: Math.max(0, x - layerGap), height: Math.max(0, ...all.map((node) => node.y + node.h / 2)) };
}

/** Move nodes towards their wishes, in order and not closer than the gap (isotonic regression). */
function settle(nodes, wish, gap) {
  const blocks = [];
  let shift = 0;
  const shifts = nodes.map((node, k) => {
    if (k) shift += (nodes[k - 1].h + node.h) / 2 + gap;
    return shift;
  });
  nodes.forEach((_, k) => {
    blocks.push({ sum: wish[k] - shifts[k], size: 1 });
    const mean = (block) => block.sum / block.size;
    while (blocks.length > 1 && mean(blocks.at(-2)) > mean(blocks.at(-1))) {
      const last = blocks.pop();
      blocks.at(-1).sum += last.sum;
      blocks.at(-1).size += last.size;
    }
  });
  let k = 0;
  for (const block of blocks) {
    for (let i = 0; i < block.size; i++, k++) nodes[k].y = block.sum / block.size + shifts[k];
  }
}
