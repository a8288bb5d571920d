import { Button, Checkbox, CopyButton, Group, Modal, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import { localStamp, zonedStamp, zoneName } from "../words/time";
import classes from "./Alerts.module.css";
import {
  type Message,
  type Topic,
  useMessages,
  useWebhookActions,
  useWebhooks,
  type Webhook,
} from "./useWebhooks";

const TOPICS: readonly [Topic, string][] = [
  ["alert.opened", "Alert opened"],
  ["alert.cleared", "Alert cleared"],
  ["alert.acknowledged", "Alert acknowledged"],
  ["deployment.changed", "Deployment changed"],
  ["rollout.changed", "Rollout changed"],
  ["policy.changed", "Policy version changed"],
];
const FIRST: Topic[] = ["alert.opened", "alert.cleared", "deployment.changed"];

/** Webhooks of this server: added, tried, removed; and what became of each message. */
export function WebhookPanel() {
  const webhooks = useWebhooks();
  if (webhooks.isError) return <p className={classes.refusal}>{errorWords(webhooks.error)}</p>;
  if (!webhooks.data) return null;
  return (
    <>
      <NewWebhook />
      <ul className={classes.list} aria-label="Webhooks">
        {webhooks.data.map((webhook) => (
          <WebhookItem key={webhook.webhook_id} webhook={webhook} />
        ))}
      </ul>
      <Messages webhooks={webhooks.data} />
    </>
  );
}

function NewWebhook() {
  const [url, setUrl] = useState("");
  const [topics, setTopics] = useState<Topic[]>(FIRST);
  const { create } = useWebhookActions();
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    create.mutate({ url: url.trim(), topics }, { onSuccess: () => setUrl("") });
  };
  return (
    <form className={classes.panel} onSubmit={submit} aria-label="New webhook">
      <TextInput
        label="Address of the other system"
        placeholder="https://"
        value={url}
        maxLength={500}
        required
        onChange={(event) => setUrl(event.currentTarget.value)}
      />
      <Checkbox.Group
        label="What it is sent"
        value={topics}
        onChange={(values) => setTopics(values as Topic[])}
      >
        <Group mt={6} gap="md">
          {TOPICS.map(([topic, label]) => (
            <Checkbox key={topic} value={topic} label={label} />
          ))}
        </Group>
      </Checkbox.Group>
      {create.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(create.error)}
        </p>
      )}
      <Button
        type="submit"
        w="fit-content"
        loading={create.isPending}
        disabled={url.trim() === "" || topics.length === 0}
      >
        Add webhook
      </Button>
      {create.data && <Secret secret={create.data.secret} />}
    </form>
  );
}

function Secret({ secret }: { secret: string }) {
  return (
    <div className={classes.secret} role="status">
      <p>Key of the signatures. Keep it now: it is never shown again.</p>
      <code data-testid="webhook-secret">{secret}</code>
      <CopyButton value={secret}>
        {({ copied, copy }) => (
          <Button size="sm" variant="default" onClick={copy}>
            {copied ? "Copied" : "Copy"}
          </Button>
        )}
      </CopyButton>
    </div>
  );
}

function WebhookItem({ webhook }: { webhook: Webhook }) {
  const [isOpen, setOpen] = useState(false);
  const { remove, test } = useWebhookActions();
  const words = TOPICS.filter(([topic]) => webhook.topics.includes(topic)).map(
    ([, label]) => label,
  );
  return (
    <li className={classes.alert} aria-label={webhook.url}>
      <span />
      <div className={classes.what}>
        <p>
          <strong>{webhook.url}</strong>
        </p>
        <p className={classes.note}>
          {words.join(", ")}. Added by {webhook.created_by}, {zonedStamp(webhook.created_utc)}.
        </p>
      </div>
      <div className={classes.actions}>
        <Button
          size="sm"
          variant="default"
          loading={test.isPending}
          onClick={() => test.mutate(webhook.webhook_id)}
        >
          Send a test
        </Button>
        <Button size="sm" variant="default" onClick={() => setOpen(true)}>
          Remove
        </Button>
        {test.isError && (
          <p className={classes.refusal} role="alert">
            {errorWords(test.error)}
          </p>
        )}
      </div>
      {isOpen && (
        <Modal opened onClose={() => setOpen(false)} title="Remove webhook" centered>
          <div className={classes.dialog}>
            <p>{webhook.url} gets nothing more, messages that wait for it included.</p>
            {remove.isError && (
              <p className={classes.refusal} role="alert">
                {errorWords(remove.error)}
              </p>
            )}
            <Button
              size="md"
              fullWidth
              data-autofocus
              loading={remove.isPending}
              onClick={() => remove.mutate(webhook.webhook_id, { onSuccess: () => setOpen(false) })}
            >
              Remove
            </Button>
          </div>
        </Modal>
      )}
    </li>
  );
}

function Messages({ webhooks }: { webhooks: readonly Webhook[] }) {
  const messages = useMessages();
  const { replay } = useWebhookActions();
  const urls = new Map(webhooks.map((webhook) => [webhook.webhook_id, webhook.url]));
  const receiver = (message: Message) =>
    message.webhook_id === null ? "E-mail" : (urls.get(message.webhook_id) ?? "removed webhook");
  if (messages.isError) return <p className={classes.refusal}>{errorWords(messages.error)}</p>;
  if (messages.rows.length === 0) {
    return messages.isSuccess ? (
      <p className={classes.note}>No message has been sent yet.</p>
    ) : null;
  }
  return (
    <div className={classes.scroll}>
      {replay.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(replay.error)}
        </p>
      )}
      <table className={classes.table}>
        <caption>Messages, newest first ({zoneName(new Date())})</caption>
        <thead>
          <tr>
            <th scope="col">When</th>
            <th scope="col">What</th>
            <th scope="col">To</th>
            <th scope="col">What became of it</th>
            <th scope="col">
              <span className="visually-hidden">Again</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {messages.rows.map((message) => (
            <tr key={message.notification_id}>
              <td>{localStamp(message.created_utc)}</td>
              <td>{message.topic}</td>
              <td>{receiver(message)}</td>
              <td>{fateWords(message)}</td>
              <td>
                {message.next_utc === null && receiver(message) !== "removed webhook" && (
                  <Button
                    size="xs"
                    variant="default"
                    aria-label={`Send again: ${message.topic}, ${localStamp(message.created_utc)}`}
                    onClick={() => replay.mutate(message.notification_id)}
                  >
                    Send again
                  </Button>
                )}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
      {messages.hasNextPage && (
        <Button variant="default" onClick={() => void messages.fetchNextPage()}>
          Older
        </Button>
      )}
    </div>
  );
}

function fateWords(message: Message): string {
  if (message.delivered_utc !== null) return `Delivered ${localStamp(message.delivered_utc)}`;
  if (message.next_utc === null) return `Given up: ${message.answer}`;
  if (message.attempts_count === 0) return "Waits to be sent";
  return `Attempt ${message.attempts_count}: ${message.answer}; next ${localStamp(message.next_utc)}`;
}
