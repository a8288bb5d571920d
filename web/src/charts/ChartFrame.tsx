import { ActionIcon, Menu } from "@mantine/core";
import { IconDownload } from "@tabler/icons-react";
import classes from "./ChartFrame.module.css";
import { download, fileName, svgToPng, svgToText } from "./export";

type Props = {
  title: string;
  note?: React.ReactNode;
  /** The chart as SVG at the moment of export; null when there is nothing to export. */
  getSvg: () => SVGSVGElement | null;
  toCsv: () => string;
  children: React.ReactNode;
};

const SHORT_LENGTH = 22;

/** Whether a note fits beside a title in one line. */
const isShort = (note: React.ReactNode) => typeof note === "string" && note.length <= SHORT_LENGTH;

/** Title and exports (PNG, SVG, CSV) around a chart. */
export function ChartFrame({ title, note, getSvg, toCsv, children }: Props) {
  const name = fileName(title);
  const savePng = async () => {
    const svg = getSvg();
    if (svg) download(`${name}.png`, await svgToPng(svg));
  };
  const saveSvg = () => {
    const svg = getSvg();
    if (svg) download(`${name}.svg`, new Blob([svgToText(svg)], { type: "image/svg+xml" }));
  };
  const saveCsv = () => download(`${name}.csv`, new Blob([toCsv()], { type: "text/csv" }));
  return (
    <section className={classes.chart} aria-label={title}>
      <header className={classes.head}>
        <h2 className={classes.title}>{title}</h2>
        {note && (
          <span className={classes.note} data-short={isShort(note) || undefined}>
            {note}
          </span>
        )}
        <Menu position="bottom-end">
          <Menu.Target>
            <ActionIcon aria-label={`Export ${title}`} size="var(--tap)" ml="auto">
              <IconDownload size={16} aria-hidden />
            </ActionIcon>
          </Menu.Target>
          <Menu.Dropdown>
            <Menu.Item onClick={() => void savePng()}>PNG</Menu.Item>
            <Menu.Item onClick={saveSvg}>SVG</Menu.Item>
            <Menu.Item onClick={saveCsv}>CSV</Menu.Item>
          </Menu.Dropdown>
        </Menu>
      </header>
      <div className={classes.body}>{children}</div>
    </section>
  );
}
