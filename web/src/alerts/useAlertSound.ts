/** A short tone when an alert begins to call for a look; only where a person has asked for it. */

import { useLocalStorage } from "@mantine/hooks";
import { useEffect, useRef } from "react";
import { useNow } from "../session/useNow";
import { needsLook } from "./attention";
import { useOpenAlerts } from "./useAlerts";

const KEY = "downrange.alert-sound";
const TONE_HZ = 880;
const TONE_S = 0.35;

export function useSoundChoice(): [boolean, (isOn: boolean) => void] {
  const [isOn, choose] = useLocalStorage({ key: KEY, defaultValue: false });
  return [isOn, choose];
}

/** A browser without a sound device, or one that nobody has touched yet, stays silent. */
export function playTone(): void {
  if (typeof AudioContext === "undefined") return;
  const context = new AudioContext();
  const tone = new OscillatorNode(context, { frequency: TONE_HZ });
  const gain = new GainNode(context, { gain: 0.2 });
  tone.connect(gain).connect(context.destination);
  tone.onended = () => void context.close();
  tone.start();
  tone.stop(context.currentTime + TONE_S);
}

/** Listens on every page; alerts that are open when the page is opened are no news. */
export function useAlertSound(play: () => void = playTone): void {
  const [isOn] = useSoundChoice();
  const alerts = useOpenAlerts();
  const now = useNow();
  const known = useRef<Set<string> | null>(null);
  useEffect(() => {
    const calling = alerts.filter((alert) => needsLook(alert, now)).map((one) => one.alert_id);
    const before = known.current;
    known.current = new Set(calling);
    if (isOn && before && calling.some((id) => !before.has(id))) play();
  }, [alerts, now, isOn, play]);
}
