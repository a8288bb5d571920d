import { ScrollTable } from "../validation/ScrollTable";
import { errorWords } from "../words/errors";
import { localStamp, zoneName } from "../words/time";
import classes from "./OnBoard.module.css";
import { type SiteKey, useSiteKeys } from "./usePolicyLife";

/** The keys by which the site signs policies, and which machines trust each. */
export function KeysPanel() {
  const keys = useSiteKeys();
  return (
    <section className={classes.panel} aria-label="Keys">
      <h2>Keys</h2>
      <p className={classes.note}>
        A machine loads only what a key that it trusts has signed. It is bound to one at its
        enrolment, and trusts those that this key vouches for. Change them by{" "}
        <code>downrange policy keys</code>.
      </p>
      {keys.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(keys.error)}
        </p>
      )}
      {keys.data && (
        <ScrollTable label="Keys of the site">
          <caption>Newest first ({zoneName(new Date())})</caption>
          <thead>
            <tr>
              <th scope="col">Fingerprint</th>
              <th scope="col">State</th>
              <th scope="col">Made</th>
              <th scope="col">Approvals</th>
              <th scope="col">Machines that trust it</th>
            </tr>
          </thead>
          <tbody>
            {keys.data.map((key) => (
              <tr key={key.key_id}>
                <th scope="row">
                  <code>{key.key_id}</code>
                </th>
                <td>{stateWords(key)}</td>
                <td>
                  {key.since_utc ? localStamp(key.since_utc) : "first start"} by {key.made_by}
                </td>
                <td>{key.approval_count}</td>
                <td>{key.machine_ids.join(", ") || "none"}</td>
              </tr>
            ))}
          </tbody>
        </ScrollTable>
      )}
    </section>
  );
}

/** "Signs", "Trusted, signs no more", or when and by whom it was revoked. */
export function stateWords(key: SiteKey): string {
  if (key.is_revoked)
    return key.revoked_utc
      ? `Revoked ${localStamp(key.revoked_utc)} by ${key.revoked_by}`
      : "Revoked";
  return key.is_signing ? "Signs" : "Trusted, signs no more";
}
