// Follow runs: one stream of events per study, whatever the number of runs.
import { address, study } from "./client.js";

const streams = new Map(); // study -> { source, runs: name -> { onEvent, onEnd } }

export const isActive = (run) => run.state === "waiting" || run.state === "running";

// `onEvent` gets each state of the run, `onEnd` the last one; a second call for a run replaces both.
export function follow(name, onEvent, onEnd, of = study) {
  if (!streams.has(of)) streams.set(of, { source: null, runs: new Map(), isStarting: false });
  const stream = streams.get(of);
  const isNew = !stream.runs.has(name);
  stream.runs.set(name, { onEvent, onEnd });
  if (isNew && !stream.isStarting) {
    stream.isStarting = true; // one stream for all runs that a page follows at once
    queueMicrotask(() => listen(of, stream));
  }
}

function listen(of, stream) {
  stream.isStarting = false;
  stream.source?.close();
  const query = new URLSearchParams([...stream.runs.keys()].map((name) => ["name", name]));
  stream.source = new EventSource(`/api/run-events/${address(of)}?${query}`);
  stream.source.addEventListener("message", (message) => {
    const run = JSON.parse(message.data);
    const callbacks = stream.runs.get(run.name);
    if (!callbacks) return;
    callbacks.onEvent(run);
    if (isActive(run)) return;
    stream.runs.delete(run.name);
    if (!stream.runs.size) stream.source.close();
    callbacks.onEnd(run);
  });
}
