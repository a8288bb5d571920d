/** The replay in the 3D view: the server plays, this keeps the same time and steers it, latest first. */

import { useCallback, useEffect, useRef, useState } from "react";
import { api, type Schema, take } from "../session/client";
import { errorWords } from "../words/errors";

type Request = Schema["ReplayRequest"];

export function useReplay(throwId: string, isAvailable: boolean) {
  const [duration_s, setDuration] = useState<number | null>(null);
  const [at_s, setAt] = useState(0);
  const [isPlaying, setPlaying] = useState(false);
  const [error, setError] = useState<string | null>(null);
  const steer = useSteering(throwId, (view) => setDuration(view.duration_s), setError);

  useEffect(() => {
    if (!isAvailable) return;
    setAt(0);
    setPlaying(false);
    void steer({ at_s: 0, playing: false, close: false });
    return () => void steer({ close: true });
  }, [isAvailable, steer]);

  useClock(isPlaying, duration_s, setAt, () => setPlaying(false));

  const seek = useCallback(
    (to_s: number) => {
      setAt(to_s);
      setPlaying(false);
      void steer({ at_s: to_s, playing: false, close: false });
    },
    [steer],
  );
  const toggle = useCallback(() => {
    const isAtEnd = duration_s !== null && at_s >= duration_s - 0.01;
    const from_s = isAtEnd ? 0 : at_s;
    setAt(from_s);
    setPlaying(!isPlaying);
    void steer({ at_s: from_s, playing: !isPlaying, close: false });
  }, [at_s, duration_s, isPlaying, steer]);
  return { duration_s, at_s, isPlaying, error, seek, toggle };
}

/** Sends one request at a time and drops what was overtaken. */
function useSteering(
  throwId: string,
  onView: (view: Schema["ReplayView"]) => void,
  onError: (text: string | null) => void,
) {
  const next = useRef<Request | null>(null);
  const isSending = useRef(false);
  const callbacks = useRef({ onView, onError });
  callbacks.current = { onView, onError };
  return useCallback(
    async (request: Request) => {
      next.current = request;
      if (isSending.current) return;
      isSending.current = true;
      while (next.current) {
        const body: Request = next.current;
        next.current = null;
        try {
          const params = { path: { throw_id: throwId } };
          const view = await take(api.POST("/api/v1/throws/{throw_id}/replay", { params, body }));
          if (!body.close) callbacks.current.onView(view);
          callbacks.current.onError(null);
        } catch (problem) {
          if (!body.close) callbacks.current.onError(errorWords(problem));
        }
      }
      isSending.current = false;
    },
    [throwId],
  );
}

/** Moves the time on while playing, with the display's own rate. */
function useClock(
  isPlaying: boolean,
  duration_s: number | null,
  setAt: (change: (at_s: number) => number) => void,
  onEnd: () => void,
) {
  const end = useRef(onEnd);
  end.current = onEnd;
  useEffect(() => {
    if (!isPlaying || duration_s === null) return;
    let before = performance.now();
    let frame = requestAnimationFrame(function tick(now) {
      const step_s = (now - before) / 1000;
      before = now;
      setAt((at_s) => {
        if (at_s + step_s < duration_s) return at_s + step_s;
        queueMicrotask(() => end.current());
        return duration_s;
      });
      frame = requestAnimationFrame(tick);
    });
    return () => cancelAnimationFrame(frame);
  }, [isPlaying, duration_s, setAt]);
}
