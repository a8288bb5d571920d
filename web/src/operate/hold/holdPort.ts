/** The page's end of the hold signal: tells the worker what to say, and that the page is alive. */

import { HEARTBEAT_MS } from "./hold";

export type ToWorker =
  | { kind: "open"; url: string }
  | { kind: "beat"; throwId: string }
  | { kind: "fresh" }
  | { kind: "rest" }
  | { kind: "close" };

export class HoldPort {
  private readonly worker: Worker;
  private timer: ReturnType<typeof setInterval> | null = null;

  constructor(url: string, onLost: () => void) {
    this.worker = new Worker(new URL("./hold.worker.ts", import.meta.url), { type: "module" });
    this.worker.addEventListener("message", onLost);
    this.worker.addEventListener("error", onLost);
    this.post({ kind: "open", url });
  }

  beat(throwId: string): void {
    this.post({ kind: "beat", throwId });
    this.timer ??= setInterval(() => this.post({ kind: "fresh" }), HEARTBEAT_MS);
  }

  rest(): void {
    this.stopTimer();
    this.post({ kind: "rest" });
  }

  close(): void {
    this.stopTimer();
    this.post({ kind: "close" });
  }

  private stopTimer(): void {
    if (this.timer !== null) clearInterval(this.timer);
    this.timer = null;
  }

  private post(message: ToWorker): void {
    this.worker.postMessage(message);
  }
}
