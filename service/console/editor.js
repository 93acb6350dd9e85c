// CodeMirror 6 in a shadow root. Only there it adopts style sheets, which the policy allows; in the
// document it would insert <style>. The colours come from a tokenizer; what is wrong the service says.
import { html, useEffect, useRef } from "./vendor/preact.js";
import * as cm from "./vendor/codemirror.js";

const KEYWORDS = new Set(`SELECT CONSTRUCT ASK DESCRIBE WHERE FROM NAMED PREFIX BASE GRAPH OPTIONAL UNION MINUS
FILTER EXISTS NOT IN BIND AS VALUES DISTINCT REDUCED GROUP BY HAVING ORDER ASC DESC LIMIT OFFSET TRUE FALSE UNDEF
REGISTER QUERY STREAM TEMPLATE COMPUTE EVERY WINDOW RANGE STEP TUMBLING ON AGGREGATE RSTREAM ISTREAM DSTREAM MONITOR
ALWAYS EVENTUALLY HISTORICALLY ONCE PREVIOUS UNTIL SINCE FORALL AND OR WITH MAX DELAY SAMPLE REPORT CHANGES VIOLATIONS
VERDICTS CHRONICLE EVENT NOEVENT OCCURS WHEN RECOGNIZED EMIT PATTERN SEQ WITHIN RETURN EQUALS OPTIONALSEQ
EQUALSOPTIONAL`.split(/\s+/));
const FUNCTIONS = new Set(`COUNT SUM MIN AVG SAMPLE GROUP_CONCAT STR LANG DATATYPE BOUND IRI ABS CEIL FLOOR ROUND CONCAT
STRLEN SUBSTR UCASE LCASE CONTAINS STRSTARTS STRENDS STRBEFORE STRAFTER YEAR MONTH DAY HOURS MINUTES SECONDS NOW IF
COALESCE REGEX REPLACE ISIRI ISBLANK ISLITERAL ISNUMERIC`.split(/\s+/));

function token(stream) {
  if (stream.eatSpace()) return null;
  if (stream.match(/^#.*/)) return "comment";
  if (stream.match(/^<[^<>"{}|^`\\\s]*>/)) return "url";
  if (stream.match(/^"(?:[^"\\]|\\.)*"?|^'(?:[^'\\]|\\.)*'?/)) return "string";
  if (stream.match(/^[?$]\w+/)) return "variableName";
  if (stream.match(/^\d+(\.\d+)?([eE][+-]?\d+)?(ns|us|ms|s|m|h|d)?\b/)) return "number";
  if (stream.match(/^[\w-]*:[\w.%-]*\w|^[\w-]*:/)) return "propertyName";
  const word = stream.match(/^\w+/)?.[0];
  if (!word) return stream.next() && "punctuation";
  if (word === "a" || KEYWORDS.has(word.toUpperCase())) return "keyword";
  return FUNCTIONS.has(word.toUpperCase()) ? "function" : null;
}

/** A line of a text: what `token` needs of CodeMirror's streams. */
class Line {
  at = 0;

  constructor(text) {
    this.text = text;
  }

  match(pattern) {
    const found = this.text.slice(this.at).match(pattern);
    this.at += found?.[0].length ?? 0;
    return found;
  }

  eatSpace() { return this.match(/^\s+/); }
  next() { return this.text[this.at++]; }
}

/** The names that a text writes as `$name`, each once: parameters, to which a form gives terms. */
export function parametersOf(text) {
  const found = new Set();
  for (const each of text.split("\n")) {
    const line = new Line(each);
    while (line.at < each.length) {
      const from = line.at;
      if (token(line) === "variableName" && each[from] === "$") found.add(each.slice(from + 1, line.at));
    }
  }
  return [...found];
}

const { tags } = cm;
const language = cm.StreamLanguage.define({
  token, languageData: { commentTokens: { line: "#" } },
  tokenTable: { function: tags.function(tags.variableName) },
});
const colours = cm.HighlightStyle.define([
  { tag: tags.keyword, fontWeight: "600" },
  { tag: tags.function(tags.variableName), color: "var(--text)" },
  { tag: tags.variableName, color: "var(--accent)" },
  { tag: tags.comment, color: "var(--faint)" },
  { tag: [tags.string, tags.number], color: "var(--warn)" },
  { tag: [tags.propertyName, tags.url], color: "var(--muted)" },
  { tag: tags.punctuation, color: "var(--faint)" },
]);
const look = cm.EditorView.theme({
  "&": { height: "100%", fontSize: "13px", color: "var(--text)" },
  "&.cm-focused": { outline: "none" },
  ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.6" },
  ".cm-content": { caretColor: "var(--accent)", padding: "10px 0" },
  ".cm-gutters": { background: "transparent", border: "0", color: "var(--faint)" },
  ".cm-cursor": { borderLeftColor: "var(--accent)" },
  ".cm-selectionBackground, &.cm-focused .cm-selectionBackground": { background: "var(--accent-soft) !important" },
  ".cm-matchingBracket": { background: "var(--accent-soft) !important", outline: "none" },
  ".cm-tooltip": { background: "var(--surface)", border: "1px solid var(--line-strong)", borderRadius: "6px", color: "var(--text)" },
  ".cm-tooltip-autocomplete > ul > li[aria-selected]": { background: "var(--accent-soft)", color: "var(--text)" },
  ".cm-completionIcon": { display: "none" },
  ".cm-diagnostic-error": { borderLeft: "3px solid var(--bad)" },
  ".cm-lintRange-error": { textDecoration: "underline wavy var(--bad)", backgroundImage: "none" },
});

/** The place of a problem in a text; none where it names no line. */
function diagnostics(document, problem) {
  if (!problem?.line || problem.line > document.lines) return [];
  const line = document.line(problem.line);
  const from = Math.min(line.to, line.from + Math.max(0, (problem.column ?? 1) - 1));
  const to = Math.min(document.length, Math.max(from + 1, Math.min(line.to, from + 1)));
  return [{ from, to, severity: "error", message: problem.detail }];
}

/** An editor. `complete`: [{label, detail}] beside the language's words; `problem`: a problem with
    line and column; `run`: for Ctrl Enter. Tab leaves it, for people without a mouse. */
export function Editor({ text, change, run, complete, problem, label }) {
  const host = useRef(), view = useRef(), now = useRef();
  now.current = { run, change, complete };
  useEffect(() => {
    const root = host.current.shadowRoot ?? host.current.attachShadow({ mode: "open" });
    const offer = (context) => {
      const word = context.matchBefore(/[\w:?-]+/);
      if (!word && !context.explicit) return null;
      const known = [...KEYWORDS].map((each) => ({ label: each }));
      const called = [...FUNCTIONS].map((each) => ({ label: each, apply: `${each}(` }));
      return { from: word?.from ?? context.pos, options: [...now.current.complete, ...known, ...called], validFor: /^[\w:-]*$/ };
    };
    const start = { key: "Mod-Enter", run: () => { now.current.run(); return true; } };
    view.current = new cm.EditorView({
      root, parent: root,
      state: cm.EditorState.create({ doc: text, extensions: [
        cm.keymap.of([start, ...cm.completionKeymap, ...cm.defaultKeymap, ...cm.historyKeymap]),
        cm.lineNumbers(), cm.history(), cm.drawSelection(), cm.bracketMatching(), language, look,
        cm.syntaxHighlighting(colours), cm.autocompletion({ override: [offer] }), cm.EditorView.lineWrapping,
        cm.EditorView.contentAttributes.of({ "aria-label": label }),
        cm.EditorView.updateListener.of((update) => {
          if (update.docChanged) now.current.change(update.state.doc.toString());
        }),
      ] }),
    });
    host.current.editor = view.current; // tests type through it
    return () => view.current.destroy();
  }, []);
  useEffect(() => {
    const { state } = view.current;
    if (text !== state.doc.toString()) view.current.dispatch({ changes: { from: 0, to: state.doc.length, insert: text } });
  }, [text]);
  useEffect(() => {
    view.current.dispatch(cm.setDiagnostics(view.current.state, diagnostics(view.current.state.doc, problem)));
  }, [problem]);
  return html`<div class="text" ref=${host}></div>`;
}
