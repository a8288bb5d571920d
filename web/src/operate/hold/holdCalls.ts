/** The calls behind one press of the hold button, from the ring to the end. */

import { api, take } from "../../session/client";
import type { Plan } from "../../session/live";
import { errorWords } from "../../words/errors";
import { type Action, ARM_RING_MS, type Hold, type HoldEvent } from "./hold";
import { holdUrl } from "./holdLink";
import { HoldPort } from "./holdPort";

type Send = (event: HoldEvent) => void;

export class HoldCalls {
  private readonly ring: ReturnType<typeof setTimeout>;
  private readonly link: HoldPort;

  /** Opens the hold socket with the press, so that it stands before the ring is full. */
  constructor(
    private readonly machineId: string,
    private readonly plan: Plan,
    private readonly send: Send,
  ) {
    this.ring = setTimeout(() => send({ kind: "ring_full" }), ARM_RING_MS);
    this.link = new HoldPort(holdUrl(machineId), () => send({ kind: "link_lost" }));
  }

  run(action: Action, state: Hold): void {
    switch (action) {
      case "stop_ring":
        clearTimeout(this.ring);
        return;
      case "arm":
        void this.arm();
        return;
      case "fire":
        void this.fire();
        return;
      case "disarm":
      case "abort":
        void this.undo(action);
        return;
      case "beat":
        if (state.phase === "holding") this.link.beat(state.throwId);
        return;
      case "rest":
        this.link.rest();
        return;
      case "start_ring":
        return;
    }
  }

  close(): void {
    clearTimeout(this.ring);
    this.link.close();
  }

  private get path() {
    return { params: { path: { plan_id: this.plan.plan_id } } };
  }

  private async arm(): Promise<void> {
    try {
      const body = { plan_hash: this.plan.plan_hash };
      await take(api.POST("/api/v1/plans/{plan_id}/arm", { ...this.path, body }));
      this.send({ kind: "armed" });
    } catch (error) {
      this.send({ kind: "failed", text: errorWords(error) });
    }
  }

  private async fire(): Promise<void> {
    try {
      const fired = await take(api.POST("/api/v1/plans/{plan_id}/fire", this.path));
      if (fired.state === "accepted") this.send({ kind: "fired", throwId: fired.throw_id });
      else this.send({ kind: "failed", text: `Unknown whether it started. ${fired.detail}` });
    } catch (error) {
      this.send({ kind: "failed", text: errorWords(error) });
    }
  }

  /** Letting go: the machine also aborts by silence, so a failure here changes nothing. */
  private async undo(what: "abort" | "disarm"): Promise<void> {
    const params = { path: { machine_id: this.machineId } };
    const url = `/api/v1/machines/{machine_id}/${what}` as const;
    await take(api.POST(url, { params })).catch(() => undefined);
  }
}
