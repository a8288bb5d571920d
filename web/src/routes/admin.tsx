import { Button } from "@mantine/core";
import { useInfiniteQuery, useQuery } from "@tanstack/react-query";
import { GateSentence } from "../operate/GateSentence";
import { api, take } from "../session/client";
import { errorWords } from "../words/errors";
import { count } from "../words/format";
import { Shortened } from "../words/Shortened";
import { localStamp, zoneName } from "../words/time";
import classes from "./admin.module.css";

const PAGE_ROWS = 100;

/** Admin: the audit log, who did what, and whether its chain is whole. */
export function AdminPage() {
  const pages = useInfiniteQuery({
    queryKey: ["audit"],
    queryFn: ({ pageParam }) =>
      take(
        api.GET("/api/v1/audit", {
          params: { query: { cursor: pageParam ?? undefined, limit: PAGE_ROWS } },
        }),
      ),
    initialPageParam: null as string | null,
    getNextPageParam: (page) => page.next_cursor,
  });
  const verdict = useQuery({
    queryKey: ["audit-verify"],
    queryFn: () => take(api.GET("/api/v1/audit/verify")),
    staleTime: 60_000,
  });
  if (pages.isError) return <GateSentence sentence={errorWords(pages.error)} />;
  const rows = pages.data?.pages.flatMap((page) => page.rows) ?? [];
  return (
    <div className={classes.page}>
      <header className={classes.head}>
        <h1>Audit log</h1>
        {verdict.data && (
          <span className={classes.verdict} data-bad={!verdict.data.is_intact || undefined}>
            {verdict.data.is_intact
              ? `Chain of ${count(verdict.data.row_count, "row")} is whole`
              : `Chain broken at row ${verdict.data.first_bad_sequence_count}: ${verdict.data.problem}`}
          </span>
        )}
        <Button
          variant="default"
          size="xs"
          onClick={() => void verdict.refetch()}
          loading={verdict.isFetching}
        >
          Verify again
        </Button>
      </header>
      <table className={classes.table}>
        <thead>
          <tr>
            <th scope="col">Row</th>
            <th scope="col">Time, {zoneName(new Date())}</th>
            <th scope="col">Who</th>
            <th scope="col">Action</th>
            <th scope="col">Phase</th>
            <th scope="col">Machine</th>
            <th scope="col">Detail</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((row) => (
            <tr key={row.sequence_count}>
              <td>{row.sequence_count}</td>
              <td>{localStamp(row.t_utc)}</td>
              <td>{row.actor}</td>
              <td>{row.action}</td>
              <td data-phase={row.phase}>{row.phase}</td>
              <td>{row.machine_id ?? ""}</td>
              <td className={classes.detail}>
                <Detail detail={row.detail} />
              </td>
            </tr>
          ))}
        </tbody>
      </table>
      {pages.hasNextPage && (
        <Button
          variant="default"
          mt="md"
          onClick={() => void pages.fetchNextPage()}
          loading={pages.isFetchingNextPage}
        >
          Older
        </Button>
      )}
    </div>
  );
}

function Detail({ detail }: { detail: unknown }) {
  const words = detailWords(detail);
  const whole = JSON.stringify(detail) ?? "";
  if (whole.length <= 4) return <>{words}</>;
  return <Shortened short={words || "ids"} whole={whole} name="Detail" />;
}

/** Ids and what is empty are left to the whole text. */
function detailWords(detail: unknown): string {
  if (typeof detail !== "object" || detail === null) return detail === null ? "" : String(detail);
  return Object.entries(detail)
    .filter(
      ([key, value]) => !key.endsWith("_id") && value !== null && value !== "" && value !== false,
    )
    .map(([key, value]) => `${key} ${typeof value === "object" ? JSON.stringify(value) : value}`)
    .join(", ");
}
