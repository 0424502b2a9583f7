// Drawing over a photo: found and rendered skyline, the gap between them, summits, strokes.
const SURE = 0.85; // Trusted columns of a lower probability are dashed.
const FOUND = "#ffd23f";
const OTHER = "#ff8a3d";
const RENDERED = "#35d0ff";
const DARK = "rgba(8, 14, 20, 0.75)";
const MOST_GAP_DEG = 1;

// A view maps photo pixels to the canvas: x = column * scale + left.
export const x = (view, column) => (column + 0.5) * view.scale + view.left;
export const y = (view, row) => (row + 0.5) * view.scale + view.top;

function stroke(ctx, path, colour, width, dash = []) {
  ctx.setLineDash([]);
  ctx.strokeStyle = DARK;
  ctx.lineWidth = width + 2;
  if (!dash.length) ctx.stroke(path);
  ctx.setLineDash(dash);
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.stroke(path);
  ctx.setLineDash([]);
}

export function drawFound(ctx, view, rows, trust, others) {
  const step = Math.max(1, Math.floor(0.5 / view.scale));
  const from = Math.max(0, Math.floor(-view.left / view.scale) - step);
  const to = Math.min(rows.length - 1, Math.ceil((view.width - view.left) / view.scale) + step);
  const paths = { sure: new Path2D(), doubtful: new Path2D() };
  let last = null;
  ctx.fillStyle = OTHER;
  for (let column = from; column <= to; column += step) {
    if (!Number.isNaN(others[column])) ctx.fillRect(x(view, column), y(view, others[column]) - 1, Math.max(1, view.scale), 2);
    const kind = Number.isNaN(rows[column]) ? null : trust[column] >= SURE ? "sure" : "doubtful";
    if (kind) {
      const at = [x(view, column), y(view, rows[column])];
      if (last === kind) paths[kind].lineTo(...at);
      else {
        paths[kind].moveTo(...(last ? [x(view, column - step), y(view, rows[column - step])] : at));
        paths[kind].lineTo(...at);
      }
    }
    last = kind;
  }
  stroke(ctx, paths.doubtful, FOUND, 1.5, [5, 4]);
  stroke(ctx, paths.sure, FOUND, 1.5);
}

export function drawLeftOut(ctx, view, rows, height) {
  ctx.fillStyle = hatch(ctx);
  let start = null;
  for (let column = 0; column <= rows.length; column++) {
    const none = column < rows.length && Number.isNaN(rows[column]);
    if (none && start === null) start = column;
    if (!none && start !== null) {
      const left = start * view.scale + view.left;
      ctx.fillRect(left, view.top, (column - start) * view.scale, height * view.scale);
      start = null;
    }
  }
}

let hatched = null;
function hatch(ctx) {
  if (hatched) return hatched;
  const tile = document.createElement("canvas");
  tile.width = tile.height = 8;
  const on = tile.getContext("2d");
  on.fillStyle = "rgba(24, 32, 40, 0.35)";
  on.fillRect(0, 0, 8, 8);
  on.strokeStyle = "rgba(255, 255, 255, 0.3)";
  on.beginPath();
  on.moveTo(0, 8);
  on.lineTo(8, 0);
  on.stroke();
  return (hatched = ctx.createPattern(tile, "repeat"));
}

export function drawRendered(ctx, view, sight) {
  const sure = new Path2D();
  const unsure = new Path2D();
  let pen = null;
  for (let k = 0; k < sight.column_px.length; k++) {
    if (sight.row_px[k] === null || sight.column_px[k] === null) {
      pen = null;
      continue;
    }
    const path = sight.is_sure[k] ? sure : unsure;
    const at = [x(view, sight.column_px[k]), y(view, sight.row_px[k])];
    if (pen === path) path.lineTo(...at);
    else path.moveTo(...at);
    pen = path;
  }
  stroke(ctx, sure, RENDERED, 4.5);
  stroke(ctx, unsure, RENDERED, 3, [2, 4]);
}

// Light blue through violet to vermilion, which also differ in lightness.
function gapColour(gap_deg) {
  const share = Math.min(1, Math.abs(gap_deg) / MOST_GAP_DEG);
  const [from, to, part] =
    share < 0.5 ? [[155, 231, 255], [217, 140, 255], share * 2] : [[217, 140, 255], [255, 77, 0], share * 2 - 1];
  return `rgb(${from.map((value, k) => Math.round(value + (to[k] - value) * part)).join(" ")})`;
}

function rowAt(sight, column) {
  let low = 0;
  let high = sight.column_px.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (sight.column_px[middle] <= column) low = middle;
    else high = middle;
  }
  return sight.row_px[low];
}

export function drawGaps(ctx, view, sight, rows) {
  ctx.lineWidth = 2;
  sight.gap_column_px.forEach((column, k) => {
    const rendered = rowAt(sight, column);
    if (rendered === null || Number.isNaN(rows[column])) return;
    ctx.strokeStyle = gapColour(sight.gap_deg[k]);
    ctx.beginPath();
    ctx.moveTo(x(view, column), y(view, rows[column]));
    ctx.lineTo(x(view, column), y(view, rendered));
    ctx.stroke();
  });
}

// The note on unnamed peaks stands above a badge with a height in the lower left corner.
export function drawSummits(ctx, view, summits, badge) {
  ctx.font = "12px system-ui, sans-serif";
  ctx.textAlign = "center";
  const taken = [];
  const write = (text, across, down) => {
    ctx.lineWidth = 3;
    ctx.strokeStyle = DARK;
    ctx.strokeText(text, across, down);
    ctx.fillStyle = "white";
    ctx.fillText(text, across, down);
  };
  const inside = summits.filter((one) => x(view, one.column_px) >= 0 && x(view, one.column_px) <= view.width);
  for (const summit of inside) {
    const at = [x(view, summit.column_px), y(view, summit.row_px)];
    const half = ctx.measureText(summit.label).width / 2 + 4;
    const middle = Math.max(half, Math.min(at[0], view.width - half));
    const level = [0, 1, 2, 3].find(
      (one) => !taken.some((other) => other.level === one && Math.abs(other.middle - middle) < other.half + half),
    );
    if (level === undefined) continue;
    taken.push({ level, middle, half });
    const foot = Math.max(14, at[1] - 30 - level * 16);
    ctx.strokeStyle = "white";
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(at[0], foot + 3);
    ctx.lineTo(at[0], at[1] - 3);
    ctx.stroke();
    write(summit.label, middle, foot);
  }
  const unnamed = inside.length - taken.length;
  if (unnamed) write(`${unnamed} ${unnamed === 1 ? "peak has" : "peaks have"} no room for a name`, view.width / 2, view.height - 16 - badge);
}

const BRUSHES = { sky: "rgba(120, 200, 255, 0.55)", ground: "rgba(230, 150, 60, 0.6)", erase: "rgba(20, 20, 20, 0.6)", line: FOUND };

export function drawStroke(ctx, view, one) {
  ctx.strokeStyle = BRUSHES[one.kind];
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.lineWidth = one.kind === "line" ? 2 : Math.max(2, 2 * one.radius * view.scale);
  ctx.beginPath();
  one.points.forEach(([column, row], k) => ctx[k ? "lineTo" : "moveTo"](x(view, column), y(view, row)));
  if (one.points.length === 1) ctx.lineTo(x(view, one.points[0][0]) + 0.1, y(view, one.points[0][1]));
  ctx.stroke();
  ctx.lineCap = "butt";
}

export function drawCross(ctx, view, [column, row], radius) {
  const across = x(view, column);
  const down = y(view, row);
  for (const [colour, width] of [[DARK, 4], ["white", 1.5]]) {
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.beginPath();
    ctx.moveTo(across - 10, down);
    ctx.lineTo(across + 10, down);
    ctx.moveTo(across, down - 10);
    ctx.lineTo(across, down + 10);
    if (radius) {
      ctx.moveTo(across + radius, down);
      ctx.arc(across, down, radius, 0, 2 * Math.PI);
    }
    ctx.stroke();
  }
}
