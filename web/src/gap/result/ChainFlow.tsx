import { crossrangeWords, downrangeWords, metres, percent } from "../../words/format";
import { intervalWords, SENTENCES, shareWords } from "../words";
import classes from "./ChainFlow.module.css";
import type { Chain, Link, Term } from "./chain";
import { IntervalBar } from "./IntervalBar";

/** Where the gap lies: the chain from command to impact, metres of miss a stage. */
export function ChainFlow({ chain }: { chain: Chain }) {
  return (
    <>
      {chain.isMetric && <p className={classes.miss}>{SENTENCES.which_miss}</p>}
      <p className={classes.note}>
        {chain.isMetric ? SENTENCES.where : SENTENCES.where_single_stage}
      </p>
      <ol className={classes.chain}>
        {chain.links.map((link) => (
          <li key={link.stage} className={classes.link} data-here={link.here || undefined}>
            <h3>
              {link.title}
              {link.here && <span className={classes.here}>{link.here}</span>}
            </h3>
            <p className={classes.dim}>{link.between}</p>
            {link.terms.length === 0 ? (
              <p className={classes.dim}>
                {chain.isMetric ? SENTENCES.no_term : SENTENCES.not_recorded}
              </p>
            ) : (
              chain.isMetric && <Terms link={link} limit_m={chain.limit_m} />
            )}
          </li>
        ))}
      </ol>
    </>
  );
}

function Terms({ link, limit_m }: { link: Link; limit_m: number }) {
  return (
    <>
      <p className={classes.sum}>
        {downrangeWords(link.downrange_m)}
        <br />
        {crossrangeWords(link.crossrange_m)}
      </p>
      <JointByJoint link={link}>
        {link.terms.map((term) => (
          <div key={term.joint ?? ""} className={classes.term}>
            {term.joint && (
              <>
                <p className={classes.joint}>
                  <strong>
                    {term.joint}
                    {term.isNamed && <span className={classes.here}> cause</span>}
                  </strong>
                  <span className={classes.dim}>{percent(term.share_ratio)}</span>
                </p>
                <p>
                  {downrangeWords(term.downrange_m)}
                  <br />
                  {crossrangeWords(term.crossrange_m)}
                </p>
              </>
            )}
            <IntervalBar
              value_m={term.downrange_m}
              ci90_m={term.ci90_m}
              limit_m={limit_m}
              words={barWords(term)}
            />
            {!term.joint && <p className={classes.dim}>{shareWords(term.share_ratio)}</p>}
          </div>
        ))}
      </JointByJoint>
    </>
  );
}

/** The terms of a stage: of several joints folded, but where the verdict points. */
function JointByJoint({ link, children }: { link: Link; children: React.ReactNode }) {
  const terms = <div className={classes.terms}>{children}</div>;
  if (link.terms.length < 2) return terms;
  return (
    <details className={classes.joints} open={link.here !== ""}>
      <summary>joint by joint</summary>
      {terms}
    </details>
  );
}

function barWords(term: Term): string {
  const [low, high] = term.ci90_m;
  return `${downrangeWords(term.downrange_m)}, ${intervalWords(metres(low), metres(high))}`;
}
