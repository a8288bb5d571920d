/**
 * The connection to the server's event stream: reconnects by itself and resyncs on every (re)opening,
 * so that nothing shown depends on an event that was missed.
 */

import type { ServerEvent } from "./live";

export const EVENT_KINDS: readonly ServerEvent["kind"][] = [
  "machine.state",
  "machine.lost",
  "lease.changed",
  "target.proposed",
  "plan.updated",
  "throw.updated",
  "gap.updated",
  "twin.updated",
  "site.updated",
  "alert",
];

const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 5000;

/** The part of EventSource that is used; tests bring their own. */
export type Source = Pick<EventSource, "addEventListener" | "close">;

export type StreamCallbacks = {
  /** Before any event of a connection is delivered; a failure counts as a failed connection. */
  resync: () => Promise<void>;
  onEvent: (event: ServerEvent) => void;
  onData: () => void;
  onOpen: (isOpen: boolean) => void;
};

export class EventStream {
  private source: Source | null = null;
  private timer: ReturnType<typeof setTimeout> | null = null;
  private retryMs = FIRST_RETRY_MS;
  private isClosed = false;

  constructor(
    private readonly open: () => Source,
    private readonly callbacks: StreamCallbacks,
  ) {}

  start(): void {
    if (this.isClosed || this.source) return;
    const source = this.open();
    this.source = source;
    const isCurrent = () => this.source === source;
    source.addEventListener("open", () => {
      if (isCurrent()) this.onOpen(isCurrent);
    });
    source.addEventListener("error", () => {
      if (isCurrent()) this.retry();
    });
    source.addEventListener("ping", () => this.callbacks.onData());
    for (const kind of EVENT_KINDS) {
      source.addEventListener(kind, (message) => {
        if (isCurrent()) this.deliver(message as MessageEvent<string>);
      });
    }
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
    this.callbacks.onData();
    this.callbacks.onOpen(true);
  }

  private deliver(message: MessageEvent<string>): void {
    this.callbacks.onData();
    this.callbacks.onEvent(JSON.parse(message.data) as ServerEvent);
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
