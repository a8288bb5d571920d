import { GateSentence } from "../operate/GateSentence";
import { OperatePanel } from "../operate/OperatePanel";
import { useNudge } from "../operate/target/useNudge";
import { useOperate } from "../operate/useOperate";
import { CameraButtons } from "../view/CameraButtons";
import { useViewSlot } from "../view/slot";
import { useViewFollows } from "../view/useView";
import classes from "./operate.module.css";

/** Operate: the 3D view fills the page, one panel over it follows the throw. */
export function OperatePage() {
  const operate = useOperate();
  const slot = useViewSlot<HTMLDivElement>();
  const isFree = operate.control.hold.phase === "idle" && operate.step !== "throw";
  useNudge(operate.target, isFree && !operate.isMarking, operate.setTarget);
  useViewFollows({
    machineId: operate.machine?.machine_id ?? null,
    mode: operate.mode,
    isPicking: isFree,
    pickFor: operate.isMarking ? "point" : "target",
  });
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Operate</h1>
      {operate.machine ? (
        <>
          <div ref={slot} className={classes.view} />
          <CameraButtons hasPreview={Boolean(operate.plan?.prediction) && isFree} />
          <OperatePanel operate={operate} />
        </>
      ) : (
        operate.gate && <GateSentence sentence={operate.gate.sentence} />
      )}
    </div>
  );
}
