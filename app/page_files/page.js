// The page: choose two clouds, register them, see what came out.
import { Viewer, rotationAbout } from "/page/viewer.js";
import { drawConvergence } from "/page/convergence.js";

const $ = (id) => document.getElementById(id);
const ROLES = ["source", "target"];
const viewer = new Viewer($("canvas"));
const files = { source: null, target: null };
const clouds = { source: null, target: null };
let answer = null;
let running = null;

// ---- files and examples ------------------------------------------------------------------------

async function listExamples() {
  const examples = await (await fetch("/page/examples.json")).json();
  for (const example of examples) {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", "false");
    button.append(example.title);
    const small = document.createElement("small");
    small.textContent = example.description;
    button.append(small);
    button.addEventListener("click", () => chooseExample(example, button));
    $("examples").append(button);
  }
}

async function chooseExample(example, button) {
  const chosen = await Promise.all(ROLES.map(async (role) => {
    const response = await fetch(`/page/${example[role]}`);
    return new File([await response.blob()], example[role]);
  }));
  ROLES.forEach((role) => { $(role).value = ""; });
  forget();
  pressed(button);
  await Promise.all(ROLES.map((role, i) => choose(role, chosen[i])));
}

function pressed(button) {
  for (const other of $("examples").children) other.setAttribute("aria-pressed", String(other === button));
}

async function choose(role, file) {
  forgetAnswer();
  hideProblem();
  files[role] = file;
  clouds[role] = null;
  $(`${role}-file`).textContent = `${file.name}, ${fileSize(file.size)}`;
  $("register").disabled = !(files.source && files.target) || Boolean(running);
  const form = new FormData();
  form.append("cloud", file);
  try {
    const preview = await send("/preview", form);
    if (files[role] !== file) return;
    clouds[role] = preview;
    $(`${role}-file`).textContent = `${file.name}, ${preview.total.toLocaleString("en")} points`;
    showBefore();
  } catch (problem) {
    if (files[role] !== file) return;
    files[role] = null;
    $("register").disabled = true;
    $(`${role}-file`).textContent = "or drop one here";
    $(role).value = "";
    showProblem(problem, role);
  }
}

function forget() {
  ROLES.forEach((role) => { files[role] = null; clouds[role] = null; });
  forgetAnswer();
}

function forgetAnswer() {
  answer = null;
  $("result").hidden = true;
  for (const id of ["show-aligned", "show-arrows", "motion", "play"]) $(id).disabled = true;
}

function fileSize(bytes) {
  return bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

// ---- the service -------------------------------------------------------------------------------

class Problem extends Error {
  constructor(document) {
    super(document.detail);
    this.document = document;
  }
}

// XMLHttpRequest, for it tells how much is uploaded.
function send(path, form, { type = "json", progress = () => {}, started = () => {} } = {}) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    request.responseType = "blob";
    if ($("key").value) request.setRequestHeader("X-API-Key", $("key").value);
    request.upload.addEventListener("progress", (event) => progress(event.loaded / event.total));
    request.upload.addEventListener("load", () => progress(1));
    request.addEventListener("load", async () => {
      try {
        if (request.status < 300) {
          resolve(type === "json" ? JSON.parse(await request.response.text()) : request.response);
        } else {
          reject(await problemOf(request));
        }
      } catch (error) { reject(error); }
    });
    request.addEventListener("error", () => reject(new Problem({
      detail: "The service can't be reached.", mend: "Is it still running? Then try again.",
    })));
    request.addEventListener("abort", () => reject(new Problem({ detail: "Cancelled.", cancelled: true })));
    started(request);
    request.send(form);
  });
}

async function problemOf(request) {
  let document;
  try {
    document = JSON.parse(await request.response.text());
  } catch {
    document = { detail: `The service answered with status ${request.status}.` };
  }
  document.retryAfter = request.getResponseHeader("Retry-After");
  if (request.status === 401) {
    $("key-row").hidden = false;
    $("key").focus();
  }
  return new Problem(document);
}

async function register() {
  hideProblem();
  forgetAnswer();
  showBefore();
  const began = performance.now();
  let phase = "Uploading";
  const tick = setInterval(() => {
    $("stage").textContent = `${phase} … ${((performance.now() - began) / 1000).toFixed(1)} s`;
  }, 100);
  $("progress").hidden = false;
  $("bar").removeAttribute("value");
  $("register").disabled = true;
  $("cancel").hidden = false;
  try {
    const registered = await send("/register", requestForm(), {
      started: (request) => { running = request; },
      progress: (share) => {
        if (share < 1) { $("bar").value = share; } else { $("bar").removeAttribute("value"); phase = "Registering"; }
      },
    });
    answer = registered;
    showAnswer();
  } catch (problem) {
    if (!problem.document?.cancelled) showProblem(problem);
    else $("problem").hidden = true;
  } finally {
    clearInterval(tick);
    running = null;
    $("progress").hidden = true;
    $("cancel").hidden = true;
    $("register").disabled = !(files.source && files.target);
  }
}

function requestForm() {
  const form = new FormData();
  ROLES.forEach((role) => form.append(role, files[role]));
  const options = {
    explain: true, max_rotation_deg: Number($("angle").value), seed: Number($("seed").value),
  };
  if ($("solver").value) options.solver = $("solver").value;
  if ($("deadline").value) options.deadline = Number($("deadline").value);
  form.append("options", JSON.stringify(options));
  return form;
}

// ---- what went wrong ---------------------------------------------------------------------------

function showProblem(problem, role) {
  const told = problem.document ?? { detail: String(problem.message ?? problem) };
  const box = $("problem");
  box.replaceChildren();
  const first = document.createElement("p");
  const strong = document.createElement("strong");
  const subject = role ?? (told.field ? told.field.replace(/\.points$/, "") : "");
  strong.textContent = subject && !["body"].includes(subject) ? `${subject}: ${told.detail}` : told.detail;
  first.append(strong);
  if (told.value) first.append(` (got ${told.value})`);
  box.append(first);
  if (told.mend) {
    const second = document.createElement("p");
    second.textContent = `What to do: ${told.mend}.`.replace("..", ".");
    box.append(second);
  }
  box.hidden = false;
}

function hideProblem() { $("problem").hidden = true; }

// ---- what came out -----------------------------------------------------------------------------

function showAnswer() {
  const { explanation, diagnostics } = answer;
  $("verdict").textContent = explanation.verdict[0].toUpperCase() + explanation.verdict.slice(1);
  const warned = diagnostics.warnings.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  });
  $("warnings").replaceChildren(...warned);
  $("findings").replaceChildren(...explanation.findings
    .filter((line) => line.subject !== "Warning").map(finding));
  $("notations").replaceChildren(...explanation.notations.map(notation));
  drawConvergence($("convergence"), diagnostics.trace);
  clouds.source = explanation.source;
  clouds.target = explanation.target;
  $("result").hidden = false;
  for (const id of ["show-aligned", "show-arrows", "motion", "play"]) $(id).disabled = false;
  $("show-source").checked = false;
  $("motion").value = 100;
  drawClouds();
  $("result").focus({ preventScroll: true });
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  $("canvas").scrollIntoView({ block: "nearest", behavior: still ? "instant" : "smooth" });
}

function finding(line) {
  const row = document.createElement("tr");
  const subject = document.createElement("th");
  subject.scope = "row";
  subject.textContent = line.subject;
  const statement = document.createElement("td");
  statement.textContent = line.statement;
  row.append(subject, statement);
  return row;
}

function notation(line) {
  const box = document.createElement("div");
  box.className = "notation";
  const name = document.createElement("h3");
  name.textContent = line.subject;
  const text = document.createElement("pre");
  text.textContent = line.statement;
  text.classList.toggle("rows", line.statement.includes("\n"));
  text.tabIndex = 0;
  const copy = document.createElement("button");
  copy.type = "button";
  copy.textContent = "Copy";
  copy.setAttribute("aria-label", `Copy ${line.subject}`);
  copy.addEventListener("click", async () => {
    const done = await copied(line.statement);
    copy.textContent = done ? "Copied" : "Select it";
    $("copied").textContent = done ? `${line.subject} copied` : "This browser doesn't let pages copy";
    setTimeout(() => { copy.textContent = "Copy"; }, 1500);
  });
  box.append(name, text, copy);
  return box;
}

async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // Without HTTPS there is only the old way.
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}

// ---- downloads ---------------------------------------------------------------------------------

async function download(path, form, name) {
  hideProblem();
  try {
    save(await send(path, form, { type: "blob" }), name);
  } catch (problem) { showProblem(problem); }
}

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function downloadAligned() {
  const form = new FormData();
  form.append("source", files.source);
  form.append("T_target_source", JSON.stringify(answer.T_target_source));
  download("/transform", form, "aligned.ply");
}

function downloadReport() {
  const form = new FormData();
  ROLES.forEach((role) => form.append(role, files[role]));
  form.append("answer", JSON.stringify({ ...answer, explanation: undefined }));
  download("/report", form, "report.html");
}

// ---- the view ----------------------------------------------------------------------------------

function colour(name) {
  return () => {
    const text = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    return [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);
  };
}

function mean(points) {
  const sum = [0, 0, 0];
  for (const p of points) for (let i = 0; i < 3; i += 1) sum[i] += p[i];
  return sum.map((v) => v / points.length);
}

// Far from the origin, as in UTM, float32 would move the points: all is drawn about one of them.
function about(origin, points) {
  const flat = new Float32Array(3 * points.length);
  points.forEach((p, k) => { for (let i = 0; i < 3; i += 1) flat[3 * k + i] = p[i] - origin[i]; });
  return flat;
}

function showBefore() {
  $("show-source").checked = true;
  drawClouds();
}

function drawClouds() {
  if (!viewer.works) {
    $("empty").textContent = "This browser has no WebGL, so the clouds can't be drawn; the numbers hold all the same.";
    return;
  }
  for (const name of ["source", "target", "aligned", "arrows-target", "arrows-aligned", "arrows-source"]) viewer.remove(name);
  const shown = ROLES.filter((role) => clouds[role]);
  $("empty").hidden = shown.length > 0;
  $("shown").textContent = shown.map((role) => {
    const { points, total } = clouds[role];
    return points.length < total ? `${role}: ${points.length.toLocaleString("en")} of ${total.toLocaleString("en")} points drawn. ` : "";
  }).join("");
  if (!shown.length) { viewer.draw(); return; }
  const origin = mean(clouds[shown[shown.length - 1]].points);
  viewer.origin = origin;
  for (const role of shown) viewer.setPoints(role, about(origin, clouds[role].points), colour(role));
  if (answer) {
    viewer.setPoints("aligned", about(origin, clouds.source.points), colour("aligned"));
    const length = 0.35 * extent(clouds.target.points, mean(clouds.target.points));
    const centred = (points) => points.map((p) => p.map((v, i) => v - origin[i]));
    const { source, target } = clouds;
    viewer.setArrows("arrows-target", centred(target.arrow_tails), target.arrow_vectors, length, colour("target"));
    viewer.setArrows("arrows-source", centred(source.arrow_tails), source.arrow_vectors, length, colour("source"));
    viewer.setArrows("arrows-aligned", centred(source.arrow_tails), source.arrow_vectors, length, colour("aligned"));
  }
  moveAligned();
  frameView();
}

function extent(points, centre) {
  let most = 0;
  for (const p of points) most = Math.max(most, Math.hypot(p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]));
  return most;
}

// Everything that is shown, with the aligned cloud's whole way once it moves.
function frameView() {
  const all = ROLES.filter((role) => clouds[role] && (role === "target" || $("show-source").checked))
    .flatMap((role) => clouds[role].points);
  if (!all.length) return;
  const centre = mean(all);
  viewer.frame(centre.map((v, i) => v - viewer.origin[i]), extent(all, centre));
  viewer.draw();
}

// The pose done to a share: its rotation about the centroid, while the centroid goes straight.
function partOfPose(share) {
  const T = answer.T_target_source;
  const [x, y, z, w] = answer.quaternion_xyzw;
  const sine = Math.hypot(x, y, z);
  const axis = sine > 1e-12 ? [x / sine, y / sine, z / sine] : [1, 0, 0];
  const R = rotationAbout(axis, 2 * Math.atan2(sine, w) * share);
  const from = mean(clouds.source.points);
  const to = [0, 1, 2].map((i) => T[i][0] * from[0] + T[i][1] * from[1] + T[i][2] * from[2] + T[i][3]);
  const at = from.map((v, i) => v + share * (to[i] - v));
  const o = viewer.origin;
  const t = [0, 1, 2].map((i) => at[i] - o[i]
    - [0, 1, 2].reduce((sum, j) => sum + R[3 * i + j] * (from[j] - o[j]), 0));
  return [R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1], R[6], R[7], R[8], t[2], 0, 0, 0, 1];
}

function moveAligned() {
  if (answer) {
    const model = partOfPose(Number($("motion").value) / 100);
    for (const name of ["aligned", "arrows-aligned"]) viewer.layer(name).model = model;
  }
  const arrows = $("show-arrows").checked;
  for (const name of ["source", "target", "aligned"]) {
    const visible = $(`show-${name}`).checked;
    if (viewer.layer(name)) viewer.layer(name).visible = visible;
    if (viewer.layer(`arrows-${name}`)) viewer.layer(`arrows-${name}`).visible = visible && arrows;
  }
  viewer.draw();
}

function play() {
  const seconds = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : 2.5;
  const began = performance.now();
  $("show-source").checked = true;
  moveAligned();
  frameView();
  const step = (now) => {
    const share = seconds ? Math.min(1, (now - began) / 1000 / seconds) : 1;
    $("motion").value = 100 * share * share * (3 - 2 * share);
    if (!answer) return;
    moveAligned();
    if (share < 1) requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

// ---- wiring ------------------------------------------------------------------------------------

for (const zone of document.querySelectorAll(".drop")) {
  const { role } = zone.dataset;
  zone.addEventListener("dragover", (event) => { event.preventDefault(); zone.classList.add("over"); });
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    const dropped = [...event.dataTransfer.files];
    pressed(null);
    // Two files dropped at once are source and target.
    if (dropped.length > 1) ROLES.forEach((each, i) => choose(each, dropped[i]));
    else if (dropped.length) choose(role, dropped[0]);
  });
  $(role).addEventListener("change", (event) => {
    const [file] = event.target.files;
    if (file) { pressed(null); choose(role, file); }
  });
}
$("form").addEventListener("submit", (event) => { event.preventDefault(); register(); });
$("cancel").addEventListener("click", () => running?.abort());
$("download-ply").addEventListener("click", downloadAligned);
$("download-report").addEventListener("click", downloadReport);
$("download-json").addEventListener("click", () => save(new Blob(
  [JSON.stringify({ ...answer, explanation: undefined }, null, 2)], { type: "application/json" }), "answer.json"));
for (const name of ["target", "source", "aligned", "arrows"]) $(`show-${name}`).addEventListener("change", moveAligned);
$("motion").addEventListener("input", moveAligned);
$("size").addEventListener("input", (event) => { viewer.pointSize = Number(event.target.value); viewer.draw(); });
$("play").addEventListener("click", play);
$("reset").addEventListener("click", () => { viewer.resetView(); frameView(); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => viewer.draw());
listExamples();
drawClouds();
