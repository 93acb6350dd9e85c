// Log in with a token where the service requires one.
import { html, useState } from "./vendor/preact.js";
import { ask } from "./http.js";
import { start } from "./state.js";
import { Trouble } from "./widgets.js";

export function Login() {
  const [token, setToken] = useState(""), [trouble, setTrouble] = useState(null);
  const send = async (event) => {
    event.preventDefault();
    try {
      await ask("/session", { method: "POST", body: { token } });
      setTrouble(null);
      start();
    } catch (error) {
      setTrouble(error);
    }
  };
  return html`<main class="page"><form class="panel login" onSubmit=${send}>
    <h2>Log in</h2>
    <p class="muted">This service requires a token. The operator makes one with <code>dyknow token</code>.</p>
    <label for="token">Token</label>
    <input id="token" type="password" autocomplete="off" value=${token} onInput=${(event) => setToken(event.target.value)} />
    <${Trouble} of=${trouble} />
    <button class="main" disabled=${!token}>Log in</button></form></main>`;
}
