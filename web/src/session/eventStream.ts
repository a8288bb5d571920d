/**
 * The connection to the server's events: a WebSocket, for a browser shares six HTTP connections among all its
 * pages, and streams in six of them would leave none for STOP. It reconnects by itself and resyncs on every
 * (re)opening, so that nothing shown depends on an event that was missed.
 */

import type { ServerEvent } from "./live";

/** What this console knows; a newer server may say more. */
const EVENT_KINDS: Record<ServerEvent["kind"], true> = {
  "machine.state": true,
  "machine.lost": true,
  "machine.retired": true,
  "lease.changed": true,
  "target.proposed": true,
  "point.picked": true,
  "plan.updated": true,
  "throw.updated": true,
  "gap.updated": true,
  "twin.updated": true,
  "site.updated": true,
  "zones.updated": true,
  alert: true,
  "alert.updated": true,
  "rollout.updated": true,
  "job.updated": true,
};

const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 5000;

/** The part of a WebSocket that is used; tests bring their own. */
export type Source = Pick<WebSocket, "addEventListener" | "close">;

/** The server's close code for a person, or an address, with too many streams open. */
const CLOSED_TOO_MANY = 4429;

export type StreamCallbacks = {
  /** Before any event of a connection is delivered; a failure counts as a failed connection. */
  resync: () => Promise<void>;
  onEvent: (event: ServerEvent) => void;
  onData: () => void;
  onOpen: (isOpen: boolean) => void;
  /** Why the server will not have this stream, in its words. */
  onRefused: (reason: string) => void;
};

export class EventStream {
  private source: Source | null = null;
  private timer: ReturnType<typeof setTimeout> | null = null;
  private retryMs = FIRST_RETRY_MS;
  private isClosed = false;
  /** Messages that came while the present state was read, which they may be newer than; null afterwards. */
  private early: string[] | null = null;

  constructor(
    private readonly open: () => Source,
    private readonly callbacks: StreamCallbacks,
  ) {}

  start(): void {
    if (this.isClosed || this.source) return;
    const source = this.open();
    this.source = source;
    this.early = [];
    const isCurrent = () => this.source === source;
    source.addEventListener("open", () => {
      if (isCurrent()) this.onOpen(isCurrent);
    });
    source.addEventListener("close", ({ code, reason }) => {
      if (!isCurrent()) return;
      if (code === CLOSED_TOO_MANY) this.callbacks.onRefused(reason);
      this.retry();
    });
    source.addEventListener("message", ({ data }) => {
      if (!isCurrent()) return;
      this.callbacks.onData();
      if (this.early) this.early.push(data as string);
      else this.deliver(data as string);
    });
  }

  /** Reconnect at once: after login, or when the network comes back. */
  kick(): void {
    this.drop();
    this.retryMs = FIRST_RETRY_MS;
    this.start();
  }

  close(): void {
    this.isClosed = true;
    this.drop();
  }

  private async onOpen(isCurrent: () => boolean): Promise<void> {
    try {
      await this.callbacks.resync();
    } catch {
      if (isCurrent()) this.retry();
      return;
    }
    if (!isCurrent()) return;
    this.retryMs = FIRST_RETRY_MS;
    const early = this.early ?? [];
    this.early = null;
    for (const text of early) this.deliver(text);
    this.callbacks.onData();
    this.callbacks.onOpen(true);
  }

  /** A list of events; an empty one is a sign of life only. */
  private deliver(text: string): void {
    for (const event of JSON.parse(text) as ServerEvent[]) {
      if (Object.hasOwn(EVENT_KINDS, event.kind)) this.callbacks.onEvent(event);
    }
  }

  private retry(): void {
    this.drop();
    this.callbacks.onOpen(false);
    if (this.isClosed) return;
    this.timer = setTimeout(() => this.start(), this.retryMs);
    this.retryMs = Math.min(this.retryMs * 2, LAST_RETRY_MS);
  }

  private drop(): void {
    if (this.timer) clearTimeout(this.timer);
    this.timer = null;
    this.source?.close();
    this.source = null;
  }
}
