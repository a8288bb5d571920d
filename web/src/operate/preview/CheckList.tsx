import { IconAlertTriangle, IconCheck, IconX } from "@tabler/icons-react";
import { useState } from "react";
import type { Schema } from "../../session/client";
import classes from "./CheckList.module.css";

type Check = Schema["CheckResult"];

const ICONS = { passed: IconCheck, warning: IconAlertTriangle, refused: IconX };

function verdict(check: Check): keyof typeof ICONS {
  if (check.passed) return "passed";
  return check.severity === "error" ? "refused" : "warning";
}

type Props = {
  checks: readonly Check[];
  /** Whether a check that did not pass stands elsewhere already; it is then folded like those that passed. */
  isTold: (check: Check) => boolean;
};

/** The machine's arming checks: refused first, each with its number and remedy; passed ones folded. */
export function CheckList({ checks, isTold }: Props) {
  const [isOpen, setOpen] = useState(false);
  const passed = checks.filter((check) => check.passed);
  const failed = checks.filter((check) => !check.passed);
  const open = isOpen ? failed : failed.filter((check) => !isTold(check));
  if (checks.length === 0) return null;
  return (
    <div className={classes.checks}>
      <ul className={classes.list}>
        {open.map((check) => (
          <CheckRow key={check.check_id} check={check} />
        ))}
        {isOpen && passed.map((check) => <CheckRow key={check.check_id} check={check} />)}
      </ul>
      <button
        type="button"
        className={classes.fold}
        aria-expanded={isOpen}
        onClick={() => setOpen(!isOpen)}
      >
        {failed.length === 0 ? (
          <IconCheck size={14} aria-hidden />
        ) : (
          <IconAlertTriangle size={14} aria-hidden />
        )}{" "}
        {passed.length} of {checks.length} checks passed
        <span className={classes.more}>{isOpen ? "Hide" : "Show"}</span>
      </button>
    </div>
  );
}

function CheckRow({ check }: { check: Check }) {
  const kind = verdict(check);
  const Icon = ICONS[kind];
  return (
    <li className={classes.check} data-kind={kind}>
      <Icon size={15} stroke={2.2} aria-hidden />
      <span>
        <span className="visually-hidden">{kind}: </span>
        {check.text}
        {!check.passed && check.remedy && <span className={classes.remedy}> {check.remedy}</span>}
      </span>
    </li>
  );
}
