/**
 * The hold signal: a WebSocket that says 20 times a second that the button is held. It has no memory and
 * never queues: what cannot be sent now is not sent.
 */

import { HEARTBEAT_MS } from "./hold";

export type Socket = Pick<WebSocket, "send" | "close" | "readyState" | "addEventListener">;

const OPEN = 1;

export class HoldLink {
  private readonly socket: Socket;
  private timer: ReturnType<typeof setInterval> | null = null;
  private throwId: string | null = null;

  constructor(
    open: () => Socket,
    private readonly onLost: () => void,
  ) {
    this.socket = open();
    this.socket.addEventListener("close", () => this.lost());
    this.socket.addEventListener("error", () => this.lost());
  }

  /** Start saying "holding". */
  beat(throwId: string): void {
    this.throwId = throwId;
    this.say(true);
    this.stopTimer();
    this.timer = setInterval(() => this.say(true), HEARTBEAT_MS);
  }

  /** Stop, and say so once. */
  rest(): void {
    if (this.timer !== null) {
      this.stopTimer();
      this.say(false);
    }
  }

  close(): void {
    this.rest();
    this.socket.close();
  }

  private say(holding: boolean): void {
    if (this.throwId === null || this.socket.readyState !== OPEN) return;
    this.socket.send(JSON.stringify({ throw_id: this.throwId, holding }));
  }

  private lost(): void {
    const wasBeating = this.timer !== null;
    this.stopTimer();
    if (wasBeating) this.onLost();
  }

  private stopTimer(): void {
    if (this.timer !== null) clearInterval(this.timer);
    this.timer = null;
  }
}

/** Address of the hold socket of a machine on this origin. */
export function holdUrl(machineId: string, base: Location = window.location): string {
  const scheme = base.protocol === "https:" ? "wss:" : "ws:";
  return `${scheme}//${base.host}/api/v1/machines/${encodeURIComponent(machineId)}/hold`;
}
