/**
 * The hold signal: a WebSocket that says 20 times a second that the button is held. It has no memory and
 * never queues: what cannot be sent now is not sent. It runs in a worker of its own, so that a page that is
 * busy drawing does not sound like an operator who let go; but only for as long as the page, which alone
 * sees the hand, has shown within `FRESH_LIMIT_MS` that it is alive.
 */

import type { components } from "../../api/schema";
import { socketUrl } from "../../session/socketUrl";
import { HEARTBEAT_MS } from "./hold";

type HoldMessage = components["schemas"]["HoldMessage"];
type HoldReply = components["schemas"]["HoldReply"];

export type Socket = Pick<WebSocket, "send" | "close" | "readyState" | "addEventListener">;

/** With the machine's 300 ms of silence a page that hangs counts as let go after 0.55 s at most. */
export const FRESH_LIMIT_MS = 250;

const OPEN = 1;

export class HoldLink {
  private readonly socket: Socket;
  private timer: ReturnType<typeof setInterval> | null = null;
  private throwId: string | null = null;
  private freshMs = 0;
  private isOver = false;
  /** The machine's time in the newest reply; each message carries it, so that its time on the way shows. */
  private machineTime: number | null = null;

  constructor(
    open: () => Socket,
    private readonly onLost: () => void,
    private readonly now: () => number = () => performance.now(),
  ) {
    this.socket = open();
    this.socket.addEventListener("message", ({ data }) => this.heard(JSON.parse(data)));
    this.socket.addEventListener("close", () => this.lost());
    this.socket.addEventListener("error", () => this.lost());
  }

  /** Start saying "holding". */
  beat(throwId: string): void {
    this.throwId = throwId;
    this.fresh();
    this.say(true);
    this.stopTimer();
    this.timer = setInterval(() => this.sayIfFresh(), HEARTBEAT_MS);
  }

  /** The page is alive and still sees the button held. */
  fresh(): void {
    this.freshMs = this.now();
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
    this.isOver = true;
    this.socket.close();
  }

  private sayIfFresh(): void {
    if (this.now() - this.freshMs <= FRESH_LIMIT_MS) this.say(true);
  }

  private say(holding: boolean): void {
    if (this.throwId === null || this.socket.readyState !== OPEN) return;
    const message: HoldMessage = {
      throw_id: this.throwId,
      holding,
      machine_t_mono_ns: this.machineTime,
    };
    this.socket.send(JSON.stringify(message));
  }

  private heard(reply: HoldReply): void {
    const isFirst = this.machineTime === null;
    this.machineTime = reply.machine_t_mono_ns;
    // The first message had no time and was not passed on.
    if (isFirst && this.timer !== null) this.sayIfFresh();
  }

  /** Reported once, also before the first beat: without a link no throw may be asked for. */
  private lost(): void {
    this.stopTimer();
    if (!this.isOver) this.onLost();
    this.isOver = true;
  }

  private stopTimer(): void {
    if (this.timer !== null) clearInterval(this.timer);
    this.timer = null;
  }
}

/** Address of the hold socket of a machine on this origin. */
export function holdUrl(machineId: string, base?: Location): string {
  return socketUrl(`/api/v1/machines/${encodeURIComponent(machineId)}/hold`, base);
}
