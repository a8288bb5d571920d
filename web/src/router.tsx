/** Addresses of the console; pages with charts are loaded when first opened. */

import {
  createRootRoute,
  createRoute,
  createRouter,
  lazyRouteComponent,
  Outlet,
  redirect,
} from "@tanstack/react-router";
import { parseAlertSearch } from "./alerts/attention";
import { parseFleetSearch } from "./fleet/rows";
import { Frame } from "./frame/Frame";
import { GateSentence } from "./operate/GateSentence";
import { parseAim } from "./operate/target/aimAddress";
import { LoginPage } from "./routes/login";
import { OperatePage } from "./routes/operate";
import { parseSearch } from "./throws/filters";

const root = createRootRoute({
  component: Outlet,
  notFoundComponent: () => <GateSentence sentence="There is no such page. Open Operate." />,
});

const login = createRoute({
  getParentRoute: () => root,
  path: "/login",
  component: LoginPage,
  validateSearch: (search: Record<string, unknown>): { back?: string } =>
    typeof search.back === "string" ? { back: search.back } : {},
});

const frame = createRoute({ getParentRoute: () => root, id: "frame", component: Frame });

const home = createRoute({
  getParentRoute: () => frame,
  path: "/",
  beforeLoad: () => {
    throw redirect({ to: "/operate" });
  },
});

const operate = createRoute({
  getParentRoute: () => frame,
  path: "/operate",
  validateSearch: parseAim,
  component: OperatePage,
});

const work = createRoute({
  getParentRoute: () => frame,
  path: "/work",
  validateSearch: (search: Record<string, unknown>): { job?: string } =>
    typeof search.job === "string" ? { job: search.job } : {},
  component: lazyRouteComponent(() => import("./routes/work"), "WorkPage"),
});

const throws = createRoute({
  getParentRoute: () => frame,
  path: "/throws",
  validateSearch: parseSearch,
  component: lazyRouteComponent(() => import("./routes/throws"), "ThrowsPage"),
});

const oneThrow = createRoute({
  getParentRoute: () => frame,
  path: "/throws/$throwId",
  component: lazyRouteComponent(() => import("./routes/throw"), "ThrowPage"),
});

const policies = createRoute({
  getParentRoute: () => frame,
  path: "/policies",
  component: lazyRouteComponent(() => import("./routes/policies"), "PoliciesPage"),
});

const gap = createRoute({
  getParentRoute: () => frame,
  path: "/gap",
  validateSearch: (search: Record<string, unknown>): { run?: string } =>
    typeof search.run === "string" ? { run: search.run } : {},
  component: lazyRouteComponent(() => import("./routes/gap"), "GapPage"),
});

const fleet = createRoute({
  getParentRoute: () => frame,
  path: "/fleet",
  validateSearch: parseFleetSearch,
  component: lazyRouteComponent(() => import("./routes/fleet"), "FleetPage"),
});

const machine = createRoute({
  getParentRoute: () => frame,
  path: "/machines/$machineId",
  component: lazyRouteComponent(() => import("./routes/machine"), "MachinePage"),
});

const alerts = createRoute({
  getParentRoute: () => frame,
  path: "/alerts",
  validateSearch: parseAlertSearch,
  component: lazyRouteComponent(() => import("./routes/alerts"), "AlertsPage"),
});

const site = createRoute({
  getParentRoute: () => frame,
  path: "/site",
  component: lazyRouteComponent(() => import("./routes/site"), "SitePage"),
});

const admin = createRoute({
  getParentRoute: () => frame,
  path: "/admin",
  component: lazyRouteComponent(() => import("./routes/admin"), "AdminPage"),
});

const tree = root.addChildren([
  login,
  frame.addChildren([
    home,
    operate,
    work,
    throws,
    oneThrow,
    site,
    policies,
    gap,
    fleet,
    machine,
    alerts,
    admin,
  ]),
]);

export const router = createRouter({ routeTree: tree, defaultPreload: "intent" });

declare module "@tanstack/react-router" {
  interface Register {
    router: typeof router;
  }
}
