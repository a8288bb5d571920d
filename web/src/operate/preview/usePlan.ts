/** Previews by itself when the target settles; follows the plan's news until it is complete. */

import { useEffect, useRef, useState } from "react";
import { api, type Schema, take } from "../../session/client";
import type { Machine, Plan } from "../../session/live";
import { dispatchLive, useLive } from "../../session/liveStore";
import { errorWords } from "../../words/errors";
import { pointKey, type Target } from "../target/target";

/** A preview that is overtaken ends at its next control tick: a short wait costs little. */
const SETTLE_MS = 100;
const ROLLOUT_COUNT = 200;

/** The plan that was asked for, and the facts it was asked for with; null once it was thrown. */
type Asked = { planId: string; key: string | null };
type Wish = { machineId: string; mode: "2d" | "3d"; target: Target; pace_ratio: number };

async function requestPlan({ machineId, mode, target, pace_ratio }: Wish): Promise<Plan> {
  const { x_m, y_m, z_m } = target;
  return take(
    api.POST("/api/v1/machines/{machine_id}/plans", {
      params: { path: { machine_id: machineId } },
      body: {
        mode,
        target: { x_m, y_m, z_m, mode },
        pace_ratio,
        rollout_count: ROLLOUT_COUNT,
      },
    }),
  );
}

/**
 * @param isWanted false while a throw runs or its result is shown: the plan stays as it was thrown
 */
export function usePlan(
  machine: Machine | null,
  mode: "2d" | "3d",
  target: Target | null,
  pace_ratio: number,
  isWanted: boolean,
) {
  const [asked, setAsked] = useState<Asked | null>(null);
  const [error, setError] = useState<string | null>(null);
  const [round, setRound] = useState(0);
  const latest = useRef(0);
  const machineId = machine?.machine_id ?? null;
  const policy = machine?.reach.modes.find((other) => other.mode === mode)?.policy_sha256 ?? null;
  // What was refused because the gripper was empty is previewed anew once it is not.
  const isLoaded = machine?.state?.payload_held ?? false;
  // A plan knows what stood around the machine: it cannot be armed once that was changed.
  const site = useLive((live) => (machineId ? live.sites[machineId]?.version_count : 0)) ?? 0;
  const zones = useLive((live) => (machineId ? live.zones[machineId]?.approved_sha256 : "")) ?? "";
  const key =
    target && machineId && policy
      ? [machineId, mode, policy, isLoaded, site, zones, pace_ratio, pointKey(target), round].join(
          " ",
        )
      : null;
  // A plan for other facts is none, from the first picture on: the hold button must not offer it.
  const planId = asked && (!isWanted || asked.key === key) ? asked.planId : null;
  const plan = useLive((live) => (planId === null ? null : (live.plans[planId] ?? null)));
  const wish = useRef<Wish | null>(null);
  wish.current = target && machineId ? { machineId, mode, target, pace_ratio } : null;

  useEffect(() => {
    const ticket = ++latest.current;
    if (!isWanted) {
      // Shown while it is thrown and after; no plan is thrown twice.
      setAsked((old) => old && { ...old, key: null });
      return;
    }
    setAsked(null);
    setError(null);
    if (key === null) return;
    const timer = setTimeout(async () => {
      if (!wish.current) return;
      try {
        const fresh = await requestPlan(wish.current);
        if (ticket !== latest.current) return;
        dispatchLive({ kind: "plan", plan: fresh });
        setAsked({ planId: fresh.plan_id, key });
      } catch (problem) {
        if (ticket === latest.current) setError(errorWords(problem));
      }
    }, SETTLE_MS);
    return () => clearTimeout(timer);
  }, [key, isWanted]);

  const estimate = useEstimate(plan, `${machineId} ${mode} ${pace_ratio}`);
  const again = () => setRound((value) => value + 1);
  useExpiry(plan, isWanted, again);
  useMissedNews(plan, isWanted, again);
  return { plan, estimate, error, again };
}

/**
 * The ellipse of the last preview with the same settings: about what a target nearby will have, shown
 * until it is computed.
 */
function useEstimate(plan: Plan | null, settings: string): Schema["LandingEllipse"] | null {
  const last = useRef<{ settings: string; ellipse: Schema["LandingEllipse"] } | null>(null);
  const ellipse = plan?.prediction?.ellipse;
  if (ellipse) last.current = { settings, ellipse };
  return last.current?.settings === settings ? last.current.ellipse : null;
}

/** A plan that ran out is previewed anew, so that what is shown can be thrown. */
function useExpiry(plan: Plan | null, isWanted: boolean, renew: () => void): void {
  const renewNow = useRef(renew);
  renewNow.current = renew;
  const expires = isWanted && plan?.state === "ready" ? plan.expires_utc : null;
  useEffect(() => {
    if (expires === null) return;
    const wait_ms = Math.max(1000, Date.parse(expires) - Date.now());
    const timer = setTimeout(() => renewNow.current(), Math.min(wait_ms, 2 ** 31 - 1));
    return () => clearTimeout(timer);
  }, [expires]);
}

/** News of a plan may be missed while the events are cut: one that is not complete is previewed anew. */
function useMissedNews(plan: Plan | null, isWanted: boolean, renew: () => void): void {
  const resyncs = useLive((live) => live.resync_count);
  const seen = useRef(resyncs);
  const latest = useRef({ plan, isWanted, renew });
  latest.current = { plan, isWanted, renew };
  useEffect(() => {
    if (resyncs === seen.current) return;
    seen.current = resyncs;
    const now = latest.current;
    if (now.isWanted && now.plan?.state === "previewing") now.renew();
  }, [resyncs]);
}
