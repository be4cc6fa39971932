// Follow a run: `onEvent` gets each state, `onEnd` the last one. Returns a function that stops.
import { address, study } from "./client.js";

export function follow(name, onEvent, onEnd, of = study) {
  const source = new EventSource(`/api/run-events/${address(of)}?name=${encodeURIComponent(name)}`);
  source.addEventListener("message", (message) => {
    const run = JSON.parse(message.data);
    onEvent(run);
    if (run.state !== "running") {
      source.close();
      onEnd(run);
    }
  });
  return () => source.close();
}
