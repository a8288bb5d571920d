import { MantineProvider } from "@mantine/core";
import { act, cleanup, renderHook } from "@testing-library/react";
import { afterEach, describe, expect, it, vi } from "vitest";
import { dispatchLive } from "../session/liveStore";
import type { Alert } from "./attention";
import { useAlertSound } from "./useAlertSound";

function alert(id: string, acknowledged_by: string | null = null): Alert {
  return {
    alert_id: id,
    rule: "lost",
    severity: "error",
    machine_id: "m001",
    text: "",
    opened_utc: "2026-11-27T11:00:00Z",
    seen_utc: "2026-11-27T11:00:00Z",
    cleared_utc: null,
    acknowledged_by,
    acknowledged_utc: null,
    note: "",
    silenced_until_utc: null,
    silenced_by: null,
  };
}

const tell = (one: Alert) =>
  act(() =>
    dispatchLive({ kind: "event", event: { kind: "alert.updated", alert: one }, sessionId: null }),
  );

function listen(isOn: boolean) {
  localStorage.setItem("downrange.alert-sound", JSON.stringify(isOn));
  const play = vi.fn();
  renderHook(() => useAlertSound(play), { wrapper: MantineProvider });
  return play;
}

afterEach(() => {
  cleanup();
  dispatchLive({ kind: "alerts", alerts: [] });
  localStorage.clear();
});

describe("the sound of alerts", () => {
  it("plays once for a new alert, not for one that was there or is acknowledged", () => {
    dispatchLive({ kind: "alerts", alerts: [alert("a")] });
    const play = listen(true);
    expect(play).not.toHaveBeenCalled();
    tell(alert("b"));
    expect(play).toHaveBeenCalledTimes(1);
    tell(alert("b", "ada"));
    expect(play).toHaveBeenCalledTimes(1);
    tell(alert("c"));
    expect(play).toHaveBeenCalledTimes(2);
  });

  it("is silent unless asked for", () => {
    const play = listen(false);
    tell(alert("b"));
    expect(play).not.toHaveBeenCalled();
  });
});
