/** The worker in which the hold signal runs; see holdLink.ts. */

import { HoldLink } from "./holdLink";
import type { ToWorker } from "./holdPort";

let link: HoldLink | null = null;

self.addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "open":
      link = new HoldLink(
        () => new WebSocket(data.url),
        () => self.postMessage("lost"),
      );
      return;
    case "beat":
      link?.beat(data.throwId);
      return;
    case "fresh":
      link?.fresh();
      return;
    case "rest":
      link?.rest();
      return;
    case "close":
      link?.close();
      self.close();
  }
});
