#!/usr/bin/env bash
# Make the files of this folder again: bundle the npm packages of package.json with esbuild.
# npm modules import each other by bare names, which browsers resolve by an import map only; an
# import map is an inline script, and the console's policy refuses these.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
cp "$here/package.json" "$work"
cd "$work"
npm install --silent --no-audit --no-fund

cat > preact.js <<'JS'
import { h } from "preact";
import htm from "htm";
export { h, render, Fragment } from "preact";
export { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
export { batch, computed, effect, signal, untracked } from "@preact/signals";
export const html = htm.bind(h);
JS
cat > codemirror.js <<'JS'
export { EditorState, StateEffect } from "@codemirror/state";
export { EditorView, drawSelection, keymap, lineNumbers } from "@codemirror/view";
export { defaultKeymap, history, historyKeymap } from "@codemirror/commands";
export {
  HighlightStyle, StreamLanguage, bracketMatching, syntaxHighlighting,
} from "@codemirror/language";
export { autocompletion, completionKeymap } from "@codemirror/autocomplete";
export { setDiagnostics } from "@codemirror/lint";
export { tags } from "@lezer/highlight";
JS
echo 'export { default } from "uplot";' > uplot.js

for name in preact codemirror uplot; do
  npx esbuild "$name.js" --bundle --minify --format=esm --target=es2022 --legal-comments=none \
    --outfile="$here/$name.js" --log-level=warning
done
cp node_modules/uplot/dist/uPlot.min.css "$here/uplot.css"
cp node_modules/@fontsource-variable/inter/files/inter-latin-wght-normal.woff2 "$here/inter.woff2"
cp node_modules/@fontsource/ibm-plex-mono/files/ibm-plex-mono-latin-400-normal.woff2 "$here/plex-mono.woff2"

# The licence of each package that a bundle contains, found by following its dependencies.
node - > "$here/LICENCES.txt" <<'JS'
const fs = require("fs");
const wanted = Object.keys(require("./package.json").dependencies), found = new Set();
while (wanted.length) {
  const name = wanted.pop();
  if (found.has(name)) continue;
  found.add(name);
  const about = require(`./node_modules/${name}/package.json`);
  wanted.push(...Object.keys(about.dependencies ?? {}));
}
for (const name of [...found].sort()) {
  const folder = `./node_modules/${name}`, { version, license } = require(`${folder}/package.json`);
  const file = fs.readdirSync(folder).find((each) => each.toLowerCase().startsWith("licen"));
  console.log(`==== ${name} ${version} (${license})\n`);
  console.log(file ? fs.readFileSync(`${folder}/${file}`, "utf8").trim() + "\n" : "");
}
JS
(cd "$here" && sha256sum *.js *.css *.woff2 > SHA256SUMS)
