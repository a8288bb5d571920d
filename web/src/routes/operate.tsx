import { GateSentence } from "../operate/GateSentence";
import { OperatePanel } from "../operate/OperatePanel";
import { useNudge } from "../operate/useNudge";
import { useOperate } from "../operate/useOperate";
import { useViewSlot } from "../view/slot";
import classes from "./operate.module.css";

/** Operate: the 3D view fills the page, one panel over it follows the throw. */
export function OperatePage() {
  const operate = useOperate();
  const slot = useViewSlot<HTMLDivElement>();
  const isFree = operate.control.hold.phase === "idle" && operate.step !== "throw";
  useNudge(operate.target, isFree, operate.setTarget);
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Operate</h1>
      {operate.machine ? (
        <>
          <div ref={slot} className={classes.view} />
          <OperatePanel operate={operate} />
        </>
      ) : (
        operate.gate && <GateSentence sentence={operate.gate.sentence} />
      )}
    </div>
  );
}
