"""What must hold for every sequence of messages, facts and delays."""

from dataclasses import replace

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from machine.conventions import Motion
from machine.messages import OperatorHeartbeat, ThrowState
from runtime.throw.protocol import LinkLost, ThrowMachine
from tests.runtime.protocol_bench import FACTS, Bench, plan

S = ThrowState
IDS = st.sampled_from(["t1", "t2", "t3"])
ISSUERS = st.sampled_from(["anna", "bert"])
EPOCHS = st.integers(0, 6)
MOVING = (Motion.ALIGN, Motion.THROW)


class Protocol(RuleBasedStateMachine):
    """Two operators, all epochs, old and new nonces, lost and late messages against one machine."""

    @initialize(epoch=EPOCHS)
    def begin(self, epoch):
        self.bench = Bench(epoch)
        self.nonces = ["never given"]
        self.given: dict[str, int] = {}
        self.fresh = 0
        self.motion = Motion.HOLD
        self.started: list[str] = []
        self.fired: dict[str, tuple[int, str]] = {}
        self.beats: dict[str, int] = {}
        self.stopped = False
        self.sequence = 0

    def do(self, act):
        """Run one message and check the step it made."""
        before, now_ns = self.bench.machine, self.bench.now_ns
        act()
        after, actions = self.bench.machine, self.bench.actions
        assert after.epoch_count >= before.epoch_count
        for event in actions.events:
            if event.kind.value == "throw_started":
                self.started.append(event.throw_id)
                self.check_start(event.throw_id, now_ns)
        if actions.reply and actions.reply.nonce:
            assert actions.reply.nonce not in self.nonces
            self.nonces.append(actions.reply.nonce)
            self.given[actions.reply.nonce] = now_ns
        return before, after, actions

    def check_start(self, throw_id, now_ns):
        assert self.started.count(throw_id) == 1, "a throw id ran twice"
        epoch, _ = self.fired[throw_id]
        assert epoch == self.bench.machine.epoch_count, "the lease changed between fire and start"
        assert now_ns - self.beats[throw_id] <= 300_000_000, "started without a heartbeat"
        assert not self.stopped, "started while stopped"

    @rule(seconds=st.sampled_from([0.01, 0.05, 0.2, 0.31, 1.01, 1.6, 9.0, 10.5]))
    def time_passes(self, seconds):
        # The loop ticks a hundred times a second: time never passes without the machine noticing.
        self.bench.wait(seconds)
        motion, self.motion = self.motion, self.bench.machine.motion
        self.do(lambda: self.bench.tick(motion=motion))

    @rule(epoch=EPOCHS, issuer=ISSUERS)
    def lease(self, epoch, issuer):
        before, after, actions = self.do(lambda: self.bench.lease(epoch_count=epoch, issuer=issuer))
        if epoch < before.epoch_count:
            assert not actions.reply.accepted and after.state is before.state

    @rule(current=st.booleans(), epoch=EPOCHS, issuer=ISSUERS)
    def arm(self, current, epoch, issuer):
        self.fresh += 1
        self.bench.facts = replace(FACTS, fresh_nonce=f"nonce-{self.fresh}")
        epoch = self.bench.machine.epoch_count if current else epoch
        before, _, actions = self.do(lambda: self.bench.arm(epoch_count=epoch, issuer=issuer))
        if actions.reply.accepted:
            assert before.state is S.DISARMED and epoch == before.epoch_count > 0

    @rule(current=st.booleans(), epoch=EPOCHS, issuer=ISSUERS, throw_id=IDS, data=st.data())
    def fire(self, current, epoch, issuer, throw_id, data):
        epoch = self.bench.machine.epoch_count if current else epoch
        self.fire_with(epoch, issuer, throw_id, data.draw(st.sampled_from(self.nonces[-3:])))

    def fire_with(self, epoch, issuer, throw_id, nonce):
        bench = self.bench
        before, after, actions = self.do(
            lambda: bench.fire(epoch_count=epoch, issuer=issuer, throw_id=throw_id, nonce=nonce)
        )
        if actions.reply.accepted and not actions.reply.is_repeat:
            assert before.state is S.ARMED and epoch == before.epoch_count
            assert nonce == before.nonce != ""
            assert bench.now_ns - self.given[nonce] <= 10_000_000_000
            assert throw_id not in self.fired
            assert after.nonce == ""
            assert issuer == before.armed_issuer
            self.fired[throw_id] = (epoch, nonce)

    @rule(
        current=st.booleans(), epoch=EPOCHS, throw_id=IDS, holding=st.booleans(), old=st.booleans()
    )
    def heartbeat(self, current, epoch, throw_id, holding, old):
        bench = self.bench
        if current:
            epoch, throw_id = bench.machine.epoch_count, bench.machine.throw_id or throw_id
        self.sequence += 0 if old else 1
        beat = OperatorHeartbeat(
            machine_id="m001",
            throw_id=throw_id,
            epoch_count=epoch,
            sequence_count=self.sequence,
            is_holding=holding,
            seen_t_mono_ns=bench.now_ns,
        )
        before, after, _ = self.do(lambda: bench.send(beat))
        if after.heartbeat_ns != before.heartbeat_ns and after.heartbeat_ns:
            assert holding and throw_id == before.throw_id and epoch == before.epoch_count
            self.beats[throw_id] = bench.now_ns

    @rule(
        current=st.booleans(),
        epoch=EPOCHS,
        verb=st.sampled_from(["abort", "disarm", "load"]),
        issuer=ISSUERS,
    )
    def other_command(self, current, epoch, verb, issuer):
        epoch = self.bench.machine.epoch_count if current else epoch
        before, after, actions = self.do(
            lambda: getattr(self.bench, verb)(epoch_count=epoch, issuer=issuer)
        )
        if epoch < before.epoch_count:
            assert not actions.reply.accepted
            # Time that has passed may have acted; the stale command itself may not have.
            assert after.state is before.state or "command_refused" not in self.bench.kinds[:1]

    @rule()
    def stop(self):
        _, after, actions = self.do(lambda: self.bench.stop(issuer="anybody"))
        assert actions.reply.accepted
        assert after.state is S.STOPPED and after.motion is Motion.STOP
        self.stopped = True

    @rule(current=st.booleans(), epoch=EPOCHS)
    def clear(self, current, epoch):
        epoch = self.bench.machine.epoch_count if current else epoch
        before, after, actions = self.do(lambda: self.bench.clear(epoch_count=epoch))
        if before.state is S.STOPPED and after.state is not S.STOPPED:
            assert epoch == before.epoch_count and actions.reply.accepted
            self.stopped = False

    @rule()
    def link_lost(self):
        _, after, _ = self.do(lambda: self.bench.send(LinkLost()))
        assert after.state not in (S.ARMED, S.ALIGNING, S.THROWING)

    @rule(
        aligned=st.booleans(),
        released=st.booleans(),
        done=st.booleans(),
        gone=st.booleans(),
        settled=st.booleans(),
        enable=st.sampled_from([True] * 5 + [False]),
    )
    def tick(self, aligned, released, done, gone, settled, enable):
        """The control step runs the motion that was decided, and reports on it."""
        facts = {
            "motion": self.motion,
            "aligned": aligned,
            "release_commanded": released,
            "throw_done": done,
            "load_gone": gone,
            "settled": settled,
            "local_enable": enable,
        }
        self.motion = self.bench.machine.motion
        self.do(lambda: self.bench.tick(**facts))

    @rule(throw_id=IDS)
    def next_step(self, throw_id):
        """What an honest operator and a healthy machine do next, so that whole throws happen often."""
        state, machine = self.bench.machine.state, self.bench.machine
        quiet = {
            "aligned": False,
            "released": False,
            "done": False,
            "gone": False,
            "settled": False,
        }
        if machine.epoch_count == 0:
            self.lease(epoch=1, issuer="anna")
        elif state is S.DISARMED:
            self.arm(current=True, epoch=0, issuer="anna")
        elif state is S.ARMED:
            self.fire_with(machine.epoch_count, machine.armed_issuer, throw_id, machine.nonce)
            self.heartbeat(current=True, epoch=0, throw_id=throw_id, holding=True, old=False)
        elif state in (S.ALIGNING, S.THROWING):
            self.heartbeat(current=True, epoch=0, throw_id=throw_id, holding=True, old=False)
            self.tick(**quiet, enable=True)
            aligning = state is S.ALIGNING
            self.tick(**{**quiet, "aligned": aligning, "released": not aligning}, enable=True)
        elif state in (S.COMMITTED, S.SETTLING):
            self.tick(**quiet, enable=True)
            self.tick(**{**quiet, "done": True, "gone": True, "settled": True}, enable=True)

    @invariant()
    def motion_needs_everything(self):
        if not hasattr(self, "bench"):
            return
        machine: ThrowMachine = self.bench.machine
        if self.stopped:
            assert machine.state is S.STOPPED and machine.motion is Motion.STOP
        if machine.motion in MOVING:
            assert machine.throw_id in self.fired and machine.throw_id in self.beats
            assert machine.plan is not None and machine.plan.plan_hash == plan().plan_hash
            assert machine.nonce == ""
        if machine.motion is Motion.ALIGN:
            assert self.fired[machine.throw_id][0] == machine.epoch_count


Protocol.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
TestProtocol = Protocol.TestCase


def test_the_rules_can_reach_a_whole_throw():
    """The property above is worth nothing if no sequence of its rules throws."""
    run = Protocol()
    run.begin(epoch=0)
    seen = set()
    for _ in range(8):
        run.next_step(throw_id="t1")
        run.motion_needs_everything()
        seen.add(run.bench.machine.state)
    assert run.started == ["t1"]
    assert {S.ARMED, S.ALIGNING, S.THROWING, S.COMMITTED, S.SETTLING, S.DISARMED} <= seen
