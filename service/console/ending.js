// Ending a request, with five seconds to take it back.
import { refresh } from "./state.js";
import { ask } from "./http.js";
import { say } from "./widgets.js";

const make = ({ path, type, body }) => ask(path, { method: "POST", type, body });

/** End a request, and offer to make it again as it was asked for; from now on, where the streams have
    forgotten its beginning. */
export async function end({ name, address, again }) {
  await ask(address, { method: "DELETE" });
  refresh();
  say(`${name} has ended`, async () => {
    try {
      await make(again()).catch((error) => {
        if (error.status !== 410) throw error;
        return make(again("now")).then(() => say(`${name} runs again, from now on`));
      });
    } catch (error) {
      say(`${name} does not run again: ${error.message}`);
    }
    refresh();
  });
}
