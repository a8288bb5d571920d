import { useMachine } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import type { Machine } from "../session/live";
import { SitePanel } from "../site/SitePanel";
import { useSite } from "../site/useSite";
import { CameraButtons } from "../view/CameraButtons";
import { useViewSlot } from "../view/slot";
import { useViewFollows } from "../view/useView";
import { errorWords } from "../words/errors";
import classes from "./site.module.css";

/** Site: what stands around a machine; the list at the left, the yard as the twin sees it at the right. */
export function SitePage() {
  const machine = useMachine();
  if (!machine) {
    return <GateSentence sentence="No machine is known yet. Fleet shows how one is added." />;
  }
  return <SiteOf key={machine.machine_id} machine={machine} />;
}

function SiteOf({ machine }: { machine: Machine }) {
  const site = useSite(machine.machine_id);
  const slot = useViewSlot<HTMLDivElement>();
  useViewFollows({ machineId: machine.machine_id, isPicking: false });
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Site of {machine.machine_id}</h1>
      <div className={classes.side}>
        {site.data && <SitePanel machine={machine} site={site.data} />}
        {site.isError && !site.data && <GateSentence sentence={errorWords(site.error)} />}
      </div>
      <div className={classes.main}>
        <div ref={slot} className={classes.view} />
        <CameraButtons hasPreview={false} />
      </div>
    </div>
  );
}
