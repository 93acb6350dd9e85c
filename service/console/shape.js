// The shape of a graph that is too large for boxes with texts: dots and lines on a canvas.
import { curve } from "./layout.js";
import { penOf, style } from "./widgets.js";

const LEAST = 1.5; // pixels: a box is seen at any distance

/** Draw a laid-out graph as a view shows it; `hits`: ids that were searched for, or null. */
export function drawShape(canvas, view, graph, drawn, hits) {
  if (!canvas.clientWidth) return;
  const pen = penOf(canvas);
  pen.translate(view.x, view.y);
  pen.scale(view.scale, view.scale);
  pen.strokeStyle = style("--line-strong");
  pen.lineWidth = 1 / view.scale;
  drawn.lines ??= new Path2D(drawn.paths.filter((path) => path.length > 1).map(curve).join(""));
  pen.stroke(drawn.lines);
  const [plain, found] = [style("--faint"), style("--accent")];
  const least = LEAST / view.scale;
  for (const node of graph.nodes) {
    const { x, y } = drawn.places.get(node.id);
    pen.fillStyle = (hits ? hits.has(node.id) : node.requests.length) ? found : plain;
    pen.fillRect(x, y - node.h / 2, Math.max(node.w, least), Math.max(node.h, least));
  }
}

/** The node at a place of the canvas; undefined: there is none. */
export function nodeAt(view, graph, drawn, left, top) {
  const x = (left - view.x) / view.scale, y = (top - view.y) / view.scale, near = 3 / view.scale;
  return graph.nodes.find((node) => {
    const at = drawn.places.get(node.id);
    return x >= at.x - near && x <= at.x + node.w + near && Math.abs(y - at.y) <= node.h / 2 + near;
  });
}
