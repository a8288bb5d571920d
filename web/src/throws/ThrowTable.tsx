import { useNavigate } from "@tanstack/react-router";
import { useEffect, useMemo, useRef, useState } from "react";
import { symmetricLimit } from "../charts/scale";
import type { Throw } from "../session/live";
import { zoneName } from "../words/time";
import classes from "./ThrowTable.module.css";
import { ThrowTableRow } from "./ThrowTableRow";
import { COLUMNS, nextOrder, type Order, sorted, sortOf } from "./throwOrder";

type Props = {
  rows: readonly Throw[];
  selected: string | null;
  onSelect: (throwId: string) => void;
  /** Throws that are compared. */
  compared: readonly string[];
  onCompare: (row: Throw, isCompared: boolean) => void;
};

const marks = { none: "", ascending: " ▲", descending: " ▼" };

/** The history, as the server pages it or sorted within the page: up and down select a row, Enter opens it. */
export function ThrowTable(props: Props) {
  const { rows: page, selected, onSelect, compared, onCompare } = props;
  const [order, setOrder] = useState<Order>(null);
  const rows = useMemo(() => sorted(page, order), [page, order]);
  const navigate = useNavigate();
  const body = useRef<HTMLTableSectionElement>(null);
  const limit_m = Math.min(
    2,
    symmetricLimit(
      rows.flatMap((row) => [
        row.measured_downrange_error_m ?? 0,
        row.measured_crossrange_error_m ?? 0,
      ]),
      0.2,
    ),
  );
  useEffect(() => {
    if (!selected) return;
    const row = body.current?.querySelector(`[data-throw="${CSS.escape(selected)}"]`);
    row?.scrollIntoView({ block: "nearest" });
  }, [selected]);

  const open = (throwId: string) => void navigate({ to: "/throws/$throwId", params: { throwId } });
  const onKeyDown = (event: React.KeyboardEvent) => {
    const index = rows.findIndex((row) => row.throw_id === selected);
    const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (event.key === "Enter" && selected && event.target === event.currentTarget) open(selected);
    if (step === 0) return;
    event.preventDefault();
    const next = rows[Math.max(0, Math.min(rows.length - 1, index + step))];
    if (next) onSelect(next.throw_id);
  };
  return (
    <div className={classes.scroll}>
      <table
        className={classes.table}
        // biome-ignore lint/a11y/noNoninteractiveElementToInteractiveRole: rows are selected by keys
        role="grid"
        tabIndex={0}
        onKeyDown={onKeyDown}
        aria-label="Throws, newest first: up and down select, Enter opens"
        aria-activedescendant={selected ? `throw-${selected}` : undefined}
      >
        <thead>
          <tr>
            <th scope="col">
              <span className="visually-hidden">Compare</span>
            </th>
            {COLUMNS.map(({ key, label }) => (
              <th key={key} scope="col" aria-sort={sortOf(order, key)}>
                <button
                  type="button"
                  className={classes.sort}
                  onClick={() => setOrder(nextOrder(order, key))}
                >
                  {key === "time" ? `Time, ${zoneName(new Date())}` : label}
                  <span aria-hidden>{marks[sortOf(order, key)]}</span>
                </button>
              </th>
            ))}
            <th scope="col" className={classes.right}>
              Pace, 0–1
            </th>
          </tr>
        </thead>
        <tbody ref={body}>
          {rows.map((row) => (
            <ThrowTableRow
              key={row.throw_id}
              row={row}
              limit_m={limit_m}
              isSelected={row.throw_id === selected}
              onSelect={onSelect}
              onOpen={open}
              isCompared={compared.includes(row.throw_id)}
              onCompare={onCompare}
            />
          ))}
        </tbody>
      </table>
    </div>
  );
}
