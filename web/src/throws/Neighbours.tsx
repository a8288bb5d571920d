import { useQueryClient } from "@tanstack/react-query";
import { Link } from "@tanstack/react-router";
import type { Schema } from "../session/client";

/** Ids of the throws beside one on the pages of the history that were looked at. */
export function neighboursOf(
  pages: readonly (Schema["ThrowPage"] | undefined)[],
  throwId: string,
): { newer: string | null; older: string | null } {
  const rows = pages.find((page) => page?.rows.some((row) => row.throw_id === throwId))?.rows ?? [];
  const index = rows.findIndex((row) => row.throw_id === throwId);
  return {
    newer: rows[index - 1]?.throw_id ?? null,
    older: (index < 0 ? undefined : rows[index + 1]?.throw_id) ?? null,
  };
}

/** To the throws before and after this one on the page of the history from which it was opened. */
export function Neighbours({ throwId }: { throwId: string }) {
  const client = useQueryClient();
  const pages = client.getQueriesData<Schema["ThrowPage"]>({ queryKey: ["throws", "page"] });
  const { newer, older } = neighboursOf(
    pages.map(([, page]) => page),
    throwId,
  );
  return (
    <>
      {newer && (
        <Link to="/throws/$throwId" params={{ throwId: newer }}>
          Newer
        </Link>
      )}
      {older && (
        <Link to="/throws/$throwId" params={{ throwId: older }}>
          Older
        </Link>
      )}
    </>
  );
}
