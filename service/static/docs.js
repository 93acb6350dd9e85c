// Draws the routes of /openapi.json and lets people try them. No outside address, no framework.
"use strict";

const $ = (id) => document.getElementById(id);

function el(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

function resolve(schema, root) {
  while (schema && schema.$ref) {
    schema = schema.$ref.replace("#/", "").split("/").reduce((at, key) => at[key], root);
  }
  return schema || {};
}

// An example value for a schema: its own example, or something of its shape.
function example(schema, root, depth = 0) {
  schema = resolve(schema, root);
  if (schema.examples) return schema.examples[0];
  if ("example" in schema) return schema.example;
  if ("default" in schema) return schema.default;
  if (schema.enum) return schema.enum[0];
  const choice = schema.anyOf || schema.oneOf || schema.allOf;
  if (choice) return example(choice[0], root, depth);
  if (depth > 5) return null;
  if (schema.type === "array") return [example(schema.items, root, depth + 1)];
  if (schema.type === "object") {
    const made = {};
    for (const [name, part] of Object.entries(schema.properties || {})) {
      made[name] = example(part, root, depth + 1);
    }
    return made;
  }
  return { integer: 1, number: 1.5, boolean: true, null: null }[schema.type] ?? "";
}

function bodyText(content, root) {
  if ("example" in content) {
    return typeof content.example === "string"
      ? content.example : JSON.stringify(content.example, null, 2);
  }
  const value = example(content.schema, root);
  return typeof value === "string" ? value : JSON.stringify(value, null, 2);
}

function parameterField(parameter) {
  const id = `p${Math.random().toString(36).slice(2)}`;
  const input = el("input", { id, name: parameter.name, placeholder: parameter.in });
  input.required = parameter.required || false;
  const label = el("label", { htmlFor: id }, parameter.name + (parameter.required ? " *" : ""));
  const field = el("div", { className: "field" }, label, input);
  if (parameter.description) field.append(el("small", {}, parameter.description));
  return { field, input, parameter };
}

async function follow(response, output, signal) {
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  while (!signal.aborted) {
    const { value, done } = await reader.read();
    if (done) break;
    text = (text + value).slice(-100000);
    output.textContent = text;
    output.scrollTop = output.scrollHeight;
  }
}

async function send(method, path, fields, body, output, signal) {
  const headers = {};
  const query = new URLSearchParams();
  for (const { input, parameter } of fields) {
    if (input.value === "") continue;
    if (parameter.in === "path") {
      path = path.replace(`{${parameter.name}}`, encodeURIComponent(input.value));
    } else if (parameter.in === "query") query.append(parameter.name, input.value);
    else headers[parameter.name] = input.value;
  }
  const options = { method, headers, signal };
  if (body) {
    headers["Content-Type"] = body.kind.value;
    options.body = body.text.value;
  }
  const target = query.size ? `${path}?${query}` : path;
  output.textContent = "…";
  try {
    const response = await fetch(target, options);
    if (response.status === 401) await session("log in to send this");
    const kind = response.headers.get("content-type") || "";
    const head = `${response.status} ${response.statusText}  ${kind}\n\n`;
    if (kind.startsWith("text/event-stream")) {
      output.textContent = head;
      await follow(response, output, signal);
      return;
    }
    const text = await response.text();
    let shown = text;
    if (/json/.test(kind) && !/ndjson/.test(kind) && text) {
      shown = JSON.stringify(JSON.parse(text), null, 2);
    }
    output.textContent = head + shown;
  } catch (error) {
    if (error.name !== "AbortError") output.textContent = String(error);
  }
}

function responsesTable(operation) {
  const table = el("table");
  for (const [status, response] of Object.entries(operation.responses || {})) {
    const kinds = Object.keys(response.content || {}).join(", ");
    table.append(el("tr", {}, el("td", { className: "mono" }, status),
      el("td", {}, response.description || ""), el("td", { className: "mono" }, kinds)));
  }
  return table;
}

function inside(method, path, operation, root) {
  const box = el("div", { className: "inside" });
  box.append(el("p", {}, operation.description || operation.summary || ""));
  const fields = (operation.parameters || []).map(parameterField);
  box.append(...fields.map((field) => field.field));
  let body = null;
  if (operation.requestBody) {
    const contents = operation.requestBody.content;
    const kind = el("select", { ariaLabel: "content type" });
    kind.append(...Object.keys(contents).map((name) => el("option", {}, name)));
    const text = el("textarea", { spellcheck: false, ariaLabel: "body" });
    const fill = () => { text.value = bodyText(contents[kind.value], root); };
    kind.addEventListener("change", fill);
    fill();
    body = { kind, text };
    box.append(el("div", { className: "row" }, el("span", {}, "body as"), kind), text);
  }
  const output = el("pre", { hidden: true });
  const button = el("button", { type: "button" }, "Send");
  let running = null;
  button.addEventListener("click", async () => {
    if (running) { running.abort(); return; }
    const missing = fields.find(({ input }) => input.required && !input.value);
    if (missing) { missing.input.focus(); return; }
    running = new AbortController();
    output.hidden = false;
    button.textContent = "Stop";
    button.className = "stop";
    await send(method.toUpperCase(), path, fields, body, output, running.signal);
    running = null;
    button.textContent = "Send";
    button.className = "";
  });
  box.append(el("div", { className: "row" }, button), output,
    el("h4", {}, "answers"), responsesTable(operation));
  return box;
}

function route(method, path, operation, root) {
  const summary = el("summary", {},
    el("span", { className: `method ${method}` }, method.toUpperCase()),
    el("span", { className: "path" }, path),
    el("span", { className: "brief" }, operation.summary || ""));
  const details = el("details", {}, summary);
  details.dataset.text = `${method} ${path} ${operation.description || ""}`.toLowerCase();
  details.addEventListener("toggle", () => {
    if (details.open && details.children.length === 1) {
      details.append(inside(method, path, operation, root));
    }
  });
  return details;
}

async function draw() {
  const root = await (await fetch("/openapi.json")).json();
  $("version").textContent = root.info.version;
  $("description").textContent = (root.info.description || "").replaceAll("`", "");
  const sections = new Map();
  for (const [path, operations] of Object.entries(root.paths)) {
    for (const [method, operation] of Object.entries(operations)) {
      const tag = (operation.tags || ["other"])[0];
      if (!sections.has(tag)) {
        sections.set(tag, el("section", {}, el("h2", { id: tag }, tag)));
        $("tags").append(el("a", { href: `#${tag}` }, tag));
      }
      sections.get(tag).append(route(method, path, operation, root));
    }
  }
  $("routes").replaceChildren(...sections.values());
  $("filter").addEventListener("input", (event) => {
    const wanted = event.target.value.toLowerCase();
    for (const details of document.querySelectorAll("details")) {
      details.hidden = !details.dataset.text.includes(wanted);
    }
    for (const section of sections.values()) {
      section.hidden = !section.querySelector("details:not([hidden])");
    }
  });
}

// What stands beside the form; red where something is wrong.
function tell(text, wrong = false) {
  $("who").textContent = text;
  $("who").className = wrong ? "wrong" : "";
}

// Where the service wants tokens: one is given once, and a cookie that scripts do not see is kept.
// `wrong` is told to who is not logged in: a session may have ended since.
async function session(wrong = "") {
  const { required, name, scopes } = await (await fetch("/session")).json();
  $("session").hidden = !required;
  if (name) tell(`logged in as ${name} (${scopes.join(", ")})`);
  else tell(wrong || "not logged in", wrong !== "");
  $("token").hidden = name !== null;
  $("log").textContent = name ? "Log out" : "Log in";
  return name;
}

async function log(event) {
  event.preventDefault();
  const isOut = $("token").hidden;
  const response = isOut
    ? await fetch("/session", { method: "DELETE" })
    : await fetch("/session", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ token: $("token").value.trim() }),
    });
  const wrong = response.ok ? "" : (await response.json()).detail;
  await session(wrong);
  // A token that is not right is there to be mended; one that is has no business in the page.
  if (wrong) $("token").select();
  else $("token").value = "";
}

function broken(error) {
  $("session").hidden = false;
  tell(`the service does not answer: ${error.message}`, true);
}

$("session").addEventListener("submit", (event) => log(event).catch(broken));
session().catch(broken);
draw().catch((error) => { $("routes").textContent = `The routes cannot be read: ${error}`; });
