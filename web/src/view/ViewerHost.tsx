import { useComputedColorScheme } from "@mantine/core";
import { useEffect, useState } from "react";
import { useSession } from "../session/useSession";
import { useSlot, useWasWanted } from "./slot";
import { useViewRequest } from "./useView";
import classes from "./ViewerHost.module.css";
import { readKey, readNews, type ViewerNews, viewerSentence } from "./viewerMessages";

const LOADING: ViewerNews = { state: "loading", detail: "" };

/**
 * The 3D view, once for all pages: moving an iframe in the document reloads it, so it stays where it is
 * and is laid over the slot of the page that wants it.
 */
export function ViewerHost() {
  const slot = useSlot();
  const wasWanted = useWasWanted();
  const scheme = useComputedColorScheme("dark", { getInitialValueInEffect: false });
  const session = useSession();
  // Only the first paint needs the scheme in the address; later the server colours the scene.
  const [firstScheme] = useState(scheme);
  const [news, setNews] = useState<ViewerNews>(LOADING);

  const request = useViewRequest();
  useEffect(() => {
    if (wasWanted) request({ theme: scheme });
  }, [request, scheme, wasWanted]);

  useEffect(() => {
    const onMessage = (event: MessageEvent) => {
      const fresh = readNews(event.data, event.origin, window.location.origin);
      if (fresh) setNews(fresh);
      const key = readKey(event.data, event.origin, window.location.origin);
      if (key) document.body.dispatchEvent(key);
    };
    window.addEventListener("message", onMessage);
    return () => window.removeEventListener("message", onMessage);
  }, []);

  if (!wasWanted) return null;
  const sentence = viewerSentence(news);
  return (
    <div
      className={classes.host}
      style={slot ? { ...slot } : undefined}
      hidden={!slot}
      data-testid="viewer"
      data-state={news.state}
    >
      <iframe
        key={session?.session_id}
        title="3D view of the machine: click the ground to set the target"
        // While it loads, Tab would end in it.
        inert={news.state !== "drawn"}
        src={`/viewer/?theme=${firstScheme}`}
        className={classes.view}
      />
      {sentence && (
        <p className={classes.sentence} role="status">
          {sentence}
        </p>
      )}
    </div>
  );
}
