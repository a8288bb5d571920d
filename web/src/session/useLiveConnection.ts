/** Keeps the event stream open while somebody is signed in. */

import { useQueryClient } from "@tanstack/react-query";
import { useEffect } from "react";
import { ALERTS } from "../alerts/useAlerts";
import { FLEET } from "../fleet/useFleet";
import { JOBS } from "../work/useJobs";
import { api, take } from "./client";
import { markData, markOpen, markRefused } from "./connection";
import { EventStream } from "./eventStream";
import type { GapRun, ServerEvent } from "./live";
import { dispatchLive } from "./liveStore";
import { ME } from "./queries";
import { socketUrl } from "./socketUrl";

const OPEN_ALERT_LIMIT = 500;

async function resync(): Promise<void> {
  const [machines, alerts] = await Promise.all([
    take(api.GET("/api/v1/machines")),
    take(api.GET("/api/v1/alerts", { params: { query: { limit: OPEN_ALERT_LIMIT } } })),
  ]);
  dispatchLive({ kind: "alerts", alerts: alerts.rows });
  dispatchLive({ kind: "resync", machines });
}

/** Name the watched machine to the server, which then sends its state at the full rate. */
function eventsUrl(machineId: string | null): string {
  const url = socketUrl("/api/v1/events/socket");
  return machineId === null ? url : `${url}?machine_id=${encodeURIComponent(machineId)}`;
}

/** A run that began to wait or has ended changes lists and results; progress alone does not. */
const isTurn = (run: GapRun) => run.state !== "running";

export function useLiveConnection(sessionId: string | null, machineId: string | null): void {
  const client = useQueryClient();
  useEffect(() => {
    if (sessionId === null) return;
    const onEvent = (event: ServerEvent) => {
      dispatchLive({ kind: "event", event, sessionId });
      if (event.kind === "twin.updated" || (event.kind === "gap.updated" && isTurn(event.run))) {
        void client.invalidateQueries({ queryKey: ["gap"] });
      }
      if (event.kind === "rollout.updated") {
        for (const key of ["policy-rollouts", "machine-policies", "deployments"])
          void client.invalidateQueries({ queryKey: [key] });
      }
      if (event.kind === "job.updated") {
        void client.invalidateQueries({ queryKey: [JOBS] });
      }
      if (event.kind === "alert.updated") {
        void client.invalidateQueries({ queryKey: [ALERTS] });
      }
      if (event.kind === "throw.updated" && event.throw.phase === "ended") {
        void client.invalidateQueries({ queryKey: ["throws"] });
        void client.invalidateQueries({ queryKey: [FLEET] });
        void client.invalidateQueries({ queryKey: ["throw", event.throw.throw_id] });
      }
    };
    const stream = new EventStream(() => new WebSocket(eventsUrl(machineId)), {
      resync: async () => {
        await resync();
        void client.invalidateQueries({ predicate: (query) => query.queryKey[0] !== ME[0] });
      },
      onEvent,
      onData: () => markData(Date.now()),
      onRefused: markRefused,
      onOpen: (isOpen) => {
        markOpen(isOpen);
        if (!isOpen) void client.invalidateQueries({ queryKey: ME });
      },
    });
    const kick = () => stream.kick();
    stream.start();
    window.addEventListener("online", kick);
    return () => {
      window.removeEventListener("online", kick);
      stream.close();
      markOpen(false);
    };
  }, [client, sessionId, machineId]);
}
