import { Outlet, useNavigate, useRouterState } from "@tanstack/react-router";
import { useEffect } from "react";
import { useLeaseKeeper } from "../machine/useLease";
import { useMachine, useMachineId } from "../machine/useMachine";
import { useLiveConnection } from "../session/useLiveConnection";
import { useSession } from "../session/useSession";
import { ViewerHost } from "../view/ViewerHost";
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
  useLiveConnection(session?.session_id ?? null, machineId);
  useLeaseKeeper(useMachine());

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
      <div className={classes.banners}>
        <OfflineBanner />
        <Alerts />
      </div>
      <ShortcutHelp />
      <div className={classes.body}>
        <Rail />
        <main className={classes.page} id="page" tabIndex={-1}>
          <ViewerHost />
          <Outlet />
        </main>
      </div>
    </div>
  );
}
