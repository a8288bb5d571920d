import { Outlet, useNavigate, useRouterState } from "@tanstack/react-router";
import { Fragment, useEffect, useState } from "react";
import { useAlertSound } from "../alerts/useAlertSound";
import { useLeaseKeeper } from "../machine/useLease";
import { useMachine, useMachineId } from "../machine/useMachine";
import { useLiveConnection } from "../session/useLiveConnection";
import { useSession } from "../session/useSession";
import { ViewerHost } from "../view/ViewerHost";
import { useZone } from "../words/zone";
import { Alerts } from "./Alerts";
import classes from "./Frame.module.css";
import { OfflineBanner } from "./OfflineBanner";
import { Rail } from "./Rail";
import { ShortcutHelp } from "./ShortcutHelp";
import { TopBar } from "./TopBar";

/** The frame around every page; without a session it leads to the login page and back. */
export function Frame() {
  const session = useSession();
  const navigate = useNavigate();
  const href = useRouterState({ select: (state) => state.location.href });
  const [machineId] = useMachineId();
  const pageKey = usePageKey(href.startsWith("/operate"));
  useLiveConnection(session?.session_id ?? null, machineId);
  useLeaseKeeper(useMachine());
  useAlertSound();

  useEffect(() => {
    // The address changes before this frame goes: only the one that was asked for leads back.
    if (session !== null || href.startsWith("/login")) return;
    void navigate({ to: "/login", search: { back: href }, replace: true });
  }, [session, href, navigate]);

  if (!session) return null;
  return (
    <div className={classes.frame}>
      <a className={classes.skip} href="#page">
        Skip to the page
      </a>
      <TopBar />
      <div className={classes.banners} data-below={href.startsWith("/alerts") || undefined}>
        <OfflineBanner />
        <Alerts />
      </div>
      <ShortcutHelp />
      <div className={classes.body}>
        <Rail />
        <main className={classes.page} id="page" tabIndex={-1}>
          <ViewerHost />
          <Fragment key={pageKey}>
            <Outlet />
          </Fragment>
        </main>
      </div>
    </div>
  );
}

/**
 * Changes when the time zone does: times stand all over the pages. Page Operate shows none, and must not let
 * go of a running throw. The key must not follow the address: it changes before the page that is left goes.
 */
function usePageKey(isOperate: boolean): number {
  const zone = useZone();
  const [shown, setShown] = useState({ zone, key: 0 });
  if (shown.zone !== zone) setShown({ zone, key: shown.key + (isOperate ? 0 : 1) });
  return shown.key;
}
