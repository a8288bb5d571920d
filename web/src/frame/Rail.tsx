import {
  IconArrowBounce,
  IconArrowsDiff,
  IconBackhoe,
  IconBell,
  IconBrain,
  IconClipboardList,
  IconMap2,
  IconTable,
  IconTruckLoading,
} from "@tabler/icons-react";
import { Link } from "@tanstack/react-router";
import { attention } from "../alerts/attention";
import { useOpenAlerts } from "../alerts/useAlerts";
import { useNow } from "../session/useNow";
import { useMay } from "../session/useSession";
import classes from "./Rail.module.css";

const PAGES = [
  { to: "/operate", label: "Operate", icon: IconArrowBounce },
  { to: "/work", label: "Work", icon: IconTruckLoading },
  { to: "/throws", label: "Throws", icon: IconTable },
  { to: "/site", label: "Site", icon: IconMap2 },
  { to: "/policies", label: "Policies", icon: IconBrain },
  { to: "/gap", label: "Gap", icon: IconArrowsDiff },
  { to: "/fleet", label: "Fleet", icon: IconBackhoe },
  { to: "/alerts", label: "Alerts", icon: IconBell },
] as const;

/** The pages of the console. */
export function Rail() {
  const mayAudit = useMay("audit.read");
  const pages = mayAudit
    ? [...PAGES, { to: "/admin", label: "Admin", icon: IconClipboardList } as const]
    : PAGES;
  return (
    <nav className={classes.rail} aria-label="Pages">
      {pages.map(({ to, label, icon: Icon }) => (
        <Link key={to} to={to} className={classes.page} activeProps={{ "aria-current": "page" }}>
          <Icon size={24} stroke={1.6} aria-hidden />
          <span>{label}</span>
          {to === "/alerts" && <AlertBadge />}
        </Link>
      ))}
    </nav>
  );
}

/** How many alerts call for a look: red with a stop or fault among them, amber else. */
function AlertBadge() {
  const calling = attention(useOpenAlerts(), useNow());
  if (calling === null) return null;
  return (
    <span className={classes.badge} data-tone={calling.tone} data-testid="alert-badge">
      <span aria-hidden>{calling.alert_count}</span>
      <span className="visually-hidden">{calling.words}</span>
    </span>
  );
}
