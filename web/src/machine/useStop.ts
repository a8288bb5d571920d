/** STOP: one press, no dialog, repeated by the console until the server has answered. */

import { useCallback, useRef, useState } from "react";
import { ApiError, api, take } from "../session/client";
import { errorWords } from "../words/errors";

const REPEAT_MS = 250;

export type StopStatus = { kind: "idle" | "sending" | "sent" | "failed"; text: string };

const IDLE: StopStatus = { kind: "idle", text: "" };

/** STOP is safe to repeat; anything the server itself refuses is not repeated. */
async function sendUntilAnswered(machineId: string | null, onTry: (text: string) => void) {
  for (;;) {
    try {
      if (machineId === null) return await take(api.POST("/api/v1/stop"));
      const params = { path: { machine_id: machineId } };
      return await take(api.POST("/api/v1/machines/{machine_id}/stop", { params }));
    } catch (error) {
      if (error instanceof ApiError && error.status >= 400 && error.status < 500) throw error;
      onTry("STOP not confirmed: repeating. Use the stop on the machine.");
      await new Promise((done) => setTimeout(done, REPEAT_MS));
    }
  }
}

export function useStop(machineId: string | null) {
  const [status, setStatus] = useState<StopStatus>(IDLE);
  const isSending = useRef(false);
  const stop = useCallback(async () => {
    if (isSending.current) return;
    isSending.current = true;
    setStatus({ kind: "sending", text: "STOP sent" });
    try {
      await sendUntilAnswered(machineId, (text) => setStatus({ kind: "failed", text }));
      setStatus({ kind: "sent", text: "" });
    } catch (error) {
      setStatus({ kind: "failed", text: `STOP failed: ${errorWords(error)}` });
    } finally {
      isSending.current = false;
    }
  }, [machineId]);
  return { stop, status };
}
