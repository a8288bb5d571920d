import { IconChevronDown, IconChevronRight } from "@tabler/icons-react";
import { useId } from "react";
import classes from "./Panel.module.css";

type Props = {
  number: number;
  title: string;
  /** What a closed step says in one line. */
  summary: string;
  isOpen: boolean;
  isPresent: boolean;
  onToggle: () => void;
  children: React.ReactNode;
};

/** One step of the panel: a line when closed, its content when open. */
export function Step({ number, title, summary, isOpen, isPresent, onToggle, children }: Props) {
  const id = useId();
  const Chevron = isOpen ? IconChevronDown : IconChevronRight;
  return (
    <section className={classes.step} data-present={isPresent || undefined}>
      <h2 className={classes.heading}>
        <button
          type="button"
          className={classes.line}
          aria-expanded={isOpen}
          aria-controls={id}
          aria-current={isPresent ? "step" : undefined}
          onClick={onToggle}
        >
          <span className={classes.number}>{number}</span>
          <span className={classes.title}>{title}</span>
          <span className={classes.summary}>{isOpen ? "" : summary}</span>
          <Chevron size={16} aria-hidden className={classes.chevron} />
        </button>
      </h2>
      <div id={id} hidden={!isOpen} className={classes.content}>
        {isOpen && children}
      </div>
    </section>
  );
}
