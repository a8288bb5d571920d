"""Every operation of the interface against every role: nobody may do more than the table says."""

from server.schemas.console import Role
from tests.cases import each
from tests.server.server_bench import api_paths

ROLES = tuple(Role)
USERS = dict(zip(ROLES, ("vic", "ada", "sue", "eve", "root"), strict=True))
LEAST = {
    Role.VIEWER: """
        logout list_machines read_machine stop_machine stop_all read_plan read_plan_frames list_throws
        read_throw_stats export_throws read_throw read_throw_series read_throw_log read_throw_csv replay_throw
        set_view read_site list_policies read_policy read_machine_policies list_gap_runs read_gap_run
        read_gap_report read_kept_reference
        read_twin_profile stream_events read_zones list_zone_versions list_deployments
        list_policy_approvals read_policy_history list_policy_keys
        compare_policies read_validation read_validation_log list_gates read_approval_basis
        list_shadows read_shadow
        list_rollouts read_rollout list_channels read_commissioning read_commissioning_report
        list_jobs read_job read_job_surface read_job_report
        list_alerts list_fleet read_yard_map read_machine_life list_retired
        read_enrolment list_drifts read_aim""",
    Role.OPERATOR: """
        propose_target remove_target load abort disarm acquire_lease release_lease create_plan arm_plan
        fire_plan mark_impact change_site undo_site change_zones
        create_job skip_job_load move_job_load add_job_load undo_job_load survey_job end_job
        undo_zones acknowledge_alert silence_alert create_gap_run create_drift_run
        cancel_gap_run preview_gap_run""",
    Role.SUPERVISOR: """
        clear_stop take_lease edit_machine place_machine unplace_machine
        list_audit verify_audit approve_zones
        export_throw_dossier export_machine_dossier read_dossier_extent""",
    Role.ENGINEER: """
        apply_aim undo_aim
        apply_gap_run undo_twin_profile deploy_policy roll_back_policy approve_policy withdraw_policy
        upload_policy retire_policy rotate_policy_key revoke_policy_key
        validate_policy cancel_validation shadow_policy set_gates start_rollout change_rollout""",
    Role.ADMIN: """
        enrol_machine renew_enrolment retire_machine list_webhooks create_webhook remove_webhook
        test_webhook list_notifications replay_notification""",
}
"""The least role that may do what; `OPEN` needs no session, `put_throw_log` is for machines."""
OPEN = {"login", "read_me", "read_health", "claim_enrolment"}
OF_MACHINES = {"put_throw_log", "read_wanted_policies", "read_policy_file", "put_self_test"}
NOT_CALLED = {"stop_all", "logout"}
"""Would stop the machines of other tests, or end the session; both are for everybody."""


def operations():
    return {
        operation["operationId"]: (method.upper(), path.removeprefix("/api/v1"))
        for path, methods in api_paths().items()
        for method, operation in methods.items()
    }


OPERATIONS = operations()
NEEDED = {name: role for role, names in LEAST.items() for name in names.split()}


def test_the_table_knows_every_operation():
    assert set(NEEDED) | OPEN | OF_MACHINES == set(OPERATIONS)


def answer(client, operation):
    """Status and error code of a call about things that do not exist."""
    method, path = OPERATIONS[operation]
    for name in (
        "machine_id",
        "plan_id",
        "throw_id",
        "gap_run_id",
        "validation_id",
        "alert_id",
        "webhook_id",
        "notification_id",
        "policy_sha256",
        "key_id",
        "rollout_id",
        "job_id",
        "shadow_id",
        "change",
        "mode",
        "name",
    ):
        path = path.replace(f"{{{name}}}", "nobody")
    assert "{" not in path
    with client.stream(method, path) as reply:
        if reply.status_code < 400:
            return reply.status_code, ""  # an event stream never ends
        reply.read()
        return reply.status_code, reply.json()["error"]["code"]


@each("role", ROLES)
def test_a_role_may_do_what_is_its_own_and_no_more(running, role):
    place = ROLES.index(role)
    with running.client(USERS[role]) as client:
        for operation, least in NEEDED.items():
            if ROLES.index(least) > place:
                assert answer(client, operation) == (403, "not_allowed"), operation
            elif operation not in NOT_CALLED:
                status, code = answer(client, operation)
                assert status != 401, operation
                assert code != "not_allowed", operation
                assert status < 500, operation
        for operation in OF_MACHINES:
            assert answer(client, operation) == (401, "wrong_token")


def test_what_is_open_is_all_that_is_open(running):
    with running.client() as nobody:
        for operation in NEEDED:
            assert answer(nobody, operation) == (401, "not_signed_in"), operation
        assert nobody.get("/auth/me").json() is None
