import { Button, useMantineColorScheme } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { Link, useParams } from "@tanstack/react-router";
import { GateSentence } from "../operate/GateSentence";
import { Scrubber } from "../replay/Scrubber";
import { SeriesGrid } from "../replay/SeriesGrid";
import { SidePanel } from "../replay/SidePanel";
import { useReplay } from "../replay/useReplay";
import { api, take } from "../session/client";
import { useMay } from "../session/useSession";
import { Neighbours } from "../throws/Neighbours";
import { useViewSlot } from "../view/slot";
import { errorWords } from "../words/errors";
import { bearingWords, heightWords, metres } from "../words/format";
import { zonedStamp } from "../words/time";
import classes from "./throw.module.css";

/** One throw: replay, time series and facts, linked by one moment in time. */
export function ThrowPage() {
  const { throwId } = useParams({ from: "/frame/throws/$throwId" });
  const params = { path: { throw_id: throwId } };
  const detail = useQuery({
    queryKey: ["throw", throwId],
    queryFn: () => take(api.GET("/api/v1/throws/{throw_id}", { params })),
  });
  const hasLog = detail.data?.row.has_log ?? false;
  const series = useQuery({
    queryKey: ["throw", throwId, "series"],
    queryFn: () => take(api.GET("/api/v1/throws/{throw_id}/series", { params })),
    enabled: hasLog,
    staleTime: Number.POSITIVE_INFINITY,
  });
  const replay = useReplay(throwId, hasLog);
  const slot = useViewSlot<HTMLDivElement>();
  const mayMark = useMay("impact.mark");
  if (detail.isError) return <GateSentence sentence={errorWords(detail.error)} />;
  if (!detail.data) return null;
  const { row } = detail.data;
  return (
    <div className={classes.page}>
      <header className={classes.head}>
        <Link to="/throws">Throws</Link>
        <Neighbours throwId={throwId} />
        <h1>
          {row.mode.toUpperCase()}, {metres(row.target.range_m)},{" "}
          {bearingWords(row.target.azimuth_rad)}
          {heightWords(row.target.z_m)}
        </h1>
        <span>
          {row.machine_id}, {zonedStamp(row.created_utc)}
        </span>
        <PrintButton />
      </header>
      <div className={classes.body}>
        <div className={classes.main}>
          {hasLog ? (
            <>
              <div className={classes.sticky}>
                <div ref={slot} className={classes.view} />
                {replay.error && <p className={classes.error}>{replay.error}</p>}
                <Scrubber
                  duration_s={replay.duration_s ?? series.data?.t_s.at(-1) ?? 0}
                  at_s={replay.at_s}
                  isPlaying={replay.isPlaying}
                  bands={series.data?.phases ?? []}
                  onSeek={replay.seek}
                  onToggle={replay.toggle}
                />
              </div>
              {series.data && (
                <SeriesGrid series={series.data} at_s={replay.at_s} onSeek={replay.seek} />
              )}
              {series.isError && <GateSentence sentence={errorWords(series.error)} />}
            </>
          ) : (
            <GateSentence sentence="No log of this throw yet. The machine sends it when it has a link; this page then shows the replay." />
          )}
        </div>
        <SidePanel detail={detail.data} mayMark={mayMark} />
      </div>
    </div>
  );
}

/** Charts are drawn in the colours of the screen: for paper they are drawn anew in light ones. */
function PrintButton() {
  const { colorScheme, setColorScheme } = useMantineColorScheme();
  const print = () => {
    setColorScheme("light");
    window.addEventListener("afterprint", () => setColorScheme(colorScheme), { once: true });
    requestAnimationFrame(() => requestAnimationFrame(() => window.print()));
  };
  return (
    <Button className={classes.print} size="compact-sm" variant="default" onClick={print}>
      Print
    </Button>
  );
}
