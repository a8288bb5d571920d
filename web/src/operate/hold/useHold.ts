/** Runs the hold machine: turns its actions into calls, and what happens into its events. */

import { useCallback, useEffect, useRef, useState } from "react";
import type { Machine, Plan, Throw } from "../../session/live";
import { type Action, type Hold, type HoldEvent, IDLE, type ReleaseCause, reduce } from "./hold";
import { HoldCalls } from "./holdCalls";

export type HoldControl = {
  hold: Hold;
  press: () => void;
  release: (cause: ReleaseCause) => void;
};

type Facts = { machine: Machine | null; plan: Plan | null };

export function useHold(facts: Facts, thrown: Throw | null, onThrow: (id: string) => void) {
  const [hold, setHold] = useState<Hold>(IDLE);
  const state = useRef<Hold>(IDLE);
  const calls = useRef<HoldCalls | null>(null);
  const latest = useRef({ facts, onThrow });
  latest.current = { facts, onThrow };

  const send = useCallback((event: HoldEvent) => {
    const [next, actions] = reduce(state.current, event);
    if (next === state.current && actions.length === 0) return;
    state.current = next;
    setHold(next);
    if (event.kind === "fired") latest.current.onThrow(event.throwId);
    for (const action of actions) run(action);
    if (next.phase === "idle") {
      calls.current?.close();
      calls.current = null;
    }

    function run(action: Action): void {
      const { machine, plan } = latest.current.facts;
      if (action === "start_ring") {
        if (machine && plan) calls.current = new HoldCalls(machine.machine_id, plan, send);
        return;
      }
      calls.current?.run(action, next);
    }
  }, []);

  const { machine, plan } = facts;
  const canPress = machine !== null && plan !== null;
  const press = useCallback(() => canPress && send({ kind: "press" }), [canPress, send]);
  const release = useCallback((cause: ReleaseCause) => send({ kind: "release", cause }), [send]);

  const lamp = machine?.lamp;
  const machineThrow = machine?.state?.throw_id ?? null;
  useEffect(() => {
    if (lamp) send({ kind: "machine", phase: lamp, throwId: machineThrow });
  }, [lamp, machineThrow, send]);

  const thrownPhase = thrown?.phase;
  const thrownId = thrown?.throw_id ?? null;
  useEffect(() => {
    if (thrownId && thrownPhase === "ended") send({ kind: "ended", throwId: thrownId });
    if (thrownId && thrownPhase === "committed")
      send({ kind: "machine", phase: "committed", throwId: thrownId });
  }, [thrownId, thrownPhase, send]);

  // Leaving the page is letting go.
  useEffect(() => () => send({ kind: "release", cause: "cancelled" }), [send]);

  return { hold, press, release } satisfies HoldControl;
}
