import { useNavigate, useSearch } from "@tanstack/react-router";
import { useState } from "react";
import { AccuracyChart } from "../charts/AccuracyChart";
import { ImpactScatter } from "../charts/ImpactScatter";
import { GateSentence } from "../operate/GateSentence";
import { FilterBar } from "../throws/FilterBar";
import { type GroupBy, isFiltered, parseSearch, type ThrowsSearch } from "../throws/filters";
import { GroupTable } from "../throws/GroupTable";
import { PageButtons } from "../throws/PageButtons";
import { ThrowTable } from "../throws/ThrowTable";
import { useThrowPage, useThrowStats } from "../throws/useThrows";
import { errorWords } from "../words/errors";
import classes from "./throws.module.css";

/** Throws: the history at the left, what it says about accuracy at the right, one selection. */
export function ThrowsPage() {
  const search = useSearch({ from: "/frame/throws" });
  const navigate = useNavigate({ from: "/throws" });
  const [selected, setSelected] = useState<string | null>(null);
  const { cursor, group = "policy", ...filters } = search;
  const page = useThrowPage(filters, cursor);
  const stats = useThrowStats(filters, group);
  const go = (change: Partial<ThrowsSearch>, replace = false) =>
    void navigate({ search: (old) => parseSearch({ ...old, ...change }), replace });
  const rows = page.data?.rows ?? [];
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Throws</h1>
      <FilterBar
        filters={filters}
        onChange={(change) => go({ ...change, cursor: undefined }, true)}
        onClear={() => void navigate({ search: parseSearch({ group }) })}
      />
      <div className={classes.body}>
        <section className={classes.history} aria-label="History">
          {page.isError && <GateSentence sentence={errorWords(page.error)} />}
          {page.data && rows.length === 0 && (
            <GateSentence
              sentence={
                isFiltered(filters)
                  ? "No throw matches these filters. Clear one."
                  : "No throw yet. Operate makes the first one."
              }
            />
          )}
          {rows.length > 0 && <ThrowTable rows={rows} selected={selected} onSelect={setSelected} />}
          <PageButtons
            rowCount={rows.length}
            isFirst={!cursor}
            nextCursor={page.data?.next_cursor ?? null}
            onCursor={(next) => go({ cursor: next })}
          />
        </section>
        {stats.data && (
          <section className={classes.charts} aria-label="Accuracy">
            <GroupTable
              stats={stats.data}
              groupBy={group}
              onGroupBy={(by: GroupBy) => go({ group: by }, true)}
            />
            <div className={classes.large}>
              <ImpactScatter stats={stats.data} selected={selected} onSelect={setSelected} />
            </div>
            <div className={classes.small}>
              <AccuracyChart stats={stats.data} axis="downrange" />
            </div>
            <div className={classes.small}>
              <AccuracyChart stats={stats.data} axis="crossrange" />
            </div>
          </section>
        )}
      </div>
    </div>
  );
}
