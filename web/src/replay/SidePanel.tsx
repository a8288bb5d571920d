import { Button } from "@mantine/core";
import { useState } from "react";
import { LandingPlot } from "../charts/LandingPlot";
import { landingVerdict } from "../operate/reason";
import type { Schema } from "../session/client";
import { MarkImpact } from "../throws/MarkImpact";
import { MissTable } from "../throws/MissTable";
import { measuredOf, predictedOf } from "../throws/marking";
import { hasLanded } from "../throws/outcome";
import { Facts, Files } from "./Facts";
import { ImpactList } from "./ImpactList";
import classes from "./SidePanel.module.css";

type Detail = Schema["ThrowDetail"];

/** Predicted against measured, corrections, people and versions, files. */
export function SidePanel({ detail, mayMark }: { detail: Detail; mayMark: boolean }) {
  const { row, plan } = detail;
  const [isMarking, setMarking] = useState(false);
  const prediction = plan?.prediction;
  const measured = measuredOf(row);
  const verdict = landingVerdict(row, plan);
  return (
    <aside className={classes.side} aria-label="Facts of the throw">
      <section>
        <h2>Predicted and measured</h2>
        <LandingPlot
          ellipse={prediction?.ellipse ?? null}
          predicted={predictedOf(plan)}
          measured={measured}
        />
        <MissTable thrown={row} />
        {verdict && <p className={classes.verdict}>{verdict.text}</p>}
      </section>
      <section>
        <h2>Impact records</h2>
        <ImpactList impacts={detail.impacts} />
        {isMarking && <MarkImpact thrown={row} plan={plan} onDone={() => setMarking(false)} />}
        {!isMarking && mayMark && hasLanded(row) && (
          <Button variant="default" fullWidth onClick={() => setMarking(true)}>
            {measured ? "Correct impact" : "Mark impact"}
          </Button>
        )}
      </section>
      <section>
        <h2>People and versions</h2>
        <Facts detail={detail} />
      </section>
      <section>
        <h2>Files</h2>
        <Files detail={detail} />
      </section>
    </aside>
  );
}
