import { Button, CopyButton } from "@mantine/core";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { zonedStamp } from "../words/time";
import classes from "./Fleet.module.css";
import { type Enrolment, type EnrolmentToken, useEnrolment, useNewToken } from "./useEnrolment";

const TESTS: Record<Enrolment["self_test"][number]["name"], string> = {
  link: "Link",
  clock: "Clock",
  policies: "Policies signed",
  driver: "Driver",
  imu: "Gripper IMU",
  calibration: "Calibration",
};

/** What is typed at the machine's computer. */
export function enrolCommand(
  server: string,
  token: string,
  siteKey: string,
  machineId: string,
): string {
  return `downrange machine enrol --server ${server} --token ${token} --site-key ${siteKey} --data ${machineId}`;
}

/** The one-time token, as a command to be copied. */
export function TokenBox({ enrolment }: { enrolment: EnrolmentToken }) {
  const command = enrolCommand(
    window.location.origin,
    enrolment.token,
    enrolment.site_key_id,
    enrolment.machine.machine_id,
  );
  return (
    <div className={classes.token} role="status">
      <p>
        Type this at the machine's computer before {zonedStamp(enrolment.expires_utc)}; it works
        once. The machine then calls in at {enrolment.link_address}, and loads only policies of the
        site's key {enrolment.site_key_id}: it refuses a server that shows another.
      </p>
      <code data-testid="enrol-command">{command}</code>
      <CopyButton value={command}>
        {({ copied, copy }) => (
          <Button size="sm" variant="default" w="fit-content" onClick={copy}>
            {copied ? "Copied" : "Copy"}
          </Button>
        )}
      </CopyButton>
    </div>
  );
}

function stageWords(enrolment: Enrolment): string {
  switch (enrolment.stage) {
    case "waiting":
      return `Waits for its token to be used, until ${zonedStamp(enrolment.expires_utc)}.`;
    case "expired":
      return "Its token has expired unused. Make a new one.";
    case "claimed":
      return `${enrolment.claimed_from} has fetched the credentials; the self-test runs.`;
    case "tested": {
      const failed = enrolment.self_test.filter((item) => !item.is_passed);
      return failed.length === 0
        ? "The self-test has passed."
        : `To mend: ${failed.map((item) => TESTS[item.name]).join(", ")}. Then: downrange machine self-test.`;
    }
  }
}

/** How far a machine is set up, and what it found of itself. */
export function SetUpProgress({ machineId }: { machineId: string }) {
  const { data } = useEnrolment(machineId);
  if (!data) return null;
  return (
    <div aria-live="polite">
      <p>{stageWords(data)}</p>
      <ul className={classes.rows} aria-label="Self-test">
        {data.self_test.map((item) => (
          <li key={item.name} data-look={!item.is_passed || undefined}>
            <strong>{item.is_passed ? "ok" : "look"}</strong> {TESTS[item.name]}
            <span className={classes.sub}>{item.detail}</span>
          </li>
        ))}
      </ul>
    </div>
  );
}

/** Set-up of a machine that was added by a token, on its own page. */
export function SetUpPanel({
  machineId,
  isConnected,
}: {
  machineId: string;
  isConnected: boolean;
}) {
  const { data } = useEnrolment(machineId);
  const may = useMay("machine.enrol");
  const renew = useNewToken(machineId);
  if (!data && (!may || isConnected)) return null;
  return (
    <section className={classes.panel} aria-label="Set-up">
      <h2>Set-up</h2>
      {data && (
        <p className={classes.dim}>
          Added by {data.created_by}, {zonedStamp(data.created_utc)}.
        </p>
      )}
      <SetUpProgress machineId={machineId} />
      {may && !isConnected && (
        <Button
          variant="default"
          size="sm"
          mt={8}
          loading={renew.isPending}
          onClick={() => renew.mutate()}
        >
          New token
        </Button>
      )}
      {renew.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(renew.error)}
        </p>
      )}
      {renew.data && <TokenBox enrolment={renew.data} />}
    </section>
  );
}
