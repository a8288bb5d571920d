import { Button, Group } from "@mantine/core";
import { useRouter } from "@tanstack/react-router";
import { count } from "../words/format";
import classes from "./PageButtons.module.css";

type Props = {
  rowCount: number;
  isFirst: boolean;
  nextCursor: string | null;
  onCursor: (cursor: string | undefined) => void;
};

/** Keyset paging: on to older ones, back by the history, or to the newest. */
export function PageButtons({ rowCount, isFirst, nextCursor, onCursor }: Props) {
  const router = useRouter();
  return (
    <nav className={classes.pages} aria-label="Pages of the history">
      <span className={classes.count}>{count(rowCount, "throw")} on this page, newest first</span>
      <Group gap={6}>
        <Button size="xs" variant="default" disabled={isFirst} onClick={() => onCursor(undefined)}>
          Newest
        </Button>
        <Button
          size="xs"
          variant="default"
          disabled={isFirst}
          onClick={() => router.history.back()}
        >
          Newer
        </Button>
        <Button
          size="xs"
          variant="default"
          disabled={nextCursor === null}
          onClick={() => onCursor(nextCursor ?? undefined)}
        >
          Older
        </Button>
      </Group>
    </nav>
  );
}
