/* The plant `mule`: Lagrangian arm with Maxwell oil drives, negative-control pump, LuGre friction.
 *
 * Momentum form of Lagrange's equations, symplectic Euler of 1 ms: with p = M(q) v,
 *     (M + h D) v' = p + h (dL/dq + force without D),  p' = M v',  q' = q + h v',
 * where D holds what drives, friction and stops gain by being implicit in v'. SI units; joints in the order
 * slew, boom, dipper, telescope, pitch, roll; frame `machine` as in docs/machine.md.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PARAMETERS(F)                                                                                   \
    F(pivot, 3) F(boom_length, 1) F(tube_offset, 1) F(tube_length, 1) F(pin_length, 1) F(roll_length, 1) \
    F(grip_length, 1) F(gripper_com, 1) F(imu_place, 3) F(mass, 6) F(inertia, 18) F(upper_inertia, 1)    \
    F(boom_cylinder, 4) F(dipper_cylinder, 4) F(area_positive, 4) F(area_negative, 4)                    \
    F(speed_positive, 4) F(speed_negative, 4) F(rated_positive, 4) F(rated_negative, 4)                  \
    F(gain_positive, 4) F(gain_negative, 4) F(band_positive, 4) F(band_negative, 4) F(dead_time, 4)      \
    F(lag, 4) F(closing_lag, 4) F(stroke_s, 4) F(play, 4) F(notch, 4) F(reduction, 4) F(load_loss, 4)    \
    F(largest_load, 4) F(bypass, 1) F(stiffness, 4) F(flow_damping, 4) F(closed_factor, 4) F(damper, 4)  \
    F(force_positive, 4) F(force_negative, 4) F(gap, 4) F(pump_flow, 1) F(pump_power, 1)                 \
    F(pump_lag, 1) F(pump_standby, 1) F(dry, 6) F(viscous, 6) F(static_ratio, 1) F(stop_low, 4)          \
    F(stop_high, 4) F(hose, 1) F(load_offset, 2) F(open_delay, 1) F(open_time, 1) F(open_sd, 1)          \
    F(drag_on_claws, 1) F(slip, 1) F(grasp, 1) F(radius, 1) F(drag, 1) F(air, 1) F(wind, 2) F(spin, 1)   \
    F(position_bias, 4) F(encoder_step, 4) F(encoder_noise, 4) F(joint_late, 4) F(imu_late, 1)           \
    F(imu_angles, 3) F(gyro_bias, 3) F(accel_bias, 3) F(gyro_drift, 1) F(base, 4)                        \
    F(sticking_spool, 4) F(shifting_load, 1) F(bad_sector, 1) F(stiffening_hose, 1) F(foaming_oil, 1)    \
    F(late_slew_brake, 1) F(crossed_pilot, 1) F(gripper_shares_pump, 1) F(claw_kick, 1)                  \
    F(wind_shear, 1) F(drifting_gyro, 1) F(weak_pump_under_pressure, 1)

#define FIELD(name, size) double name[size];
typedef struct {
    PARAMETERS(FIELD)
} Parameters;
#define NAME(name, size) #name ":" #size " "
const char *mule_parameter_names(void) { return PARAMETERS(NAME); }
int mule_parameters_size(void) { return (int)(sizeof(Parameters) / sizeof(double)); }

typedef struct {
    double joint_time, position[4], velocity[4], imu_time, gyro[3], accel[3], held, pressure;
    double ball_time, ball[3], impact_time, impact[3], collided, true_position[6];
} Output;
int mule_output_size(void) { return (int)(sizeof(Output) / sizeof(double)); }

enum { BODIES = 6, ROWS = 36, HISTORY = 1024, IMU_HISTORY = 64 };
static const double H = 1e-3, GRAVITY = 9.81;
static const int ENCODER_MS = 4, JOINT_LATE_MS = 6, IMU_MS = 8, IMU_LATE_MS = 40, BALL_MS = 25;

typedef struct {
    Parameters p;
    uint64_t rng;
    int64_t ms, reset_ms;
    double q[6], v[6], momentum[6], start[6], bristle[6];
    double force[4], slack[4], played[4], spool[4], pump, pressure, brake_s, stick_until[4];
    double commands[HISTORY][4], poses[HISTORY][4];
    double observed[4], observed_speed[4], encoder_ms;
    double imu_velocity[3], accel_filter[3], imu[IMU_HISTORY][6];
    double opened_s, claw, release_noise, slip[3], grasp[3], shift, wander[3];
    int held, sticks, collided, frozen, flying, landed;
    double surface, switch_ms, ball[3], ball_speed[3], ball_spin[3], ball_seen[3], ball_ms, next_ball[3], next_ms;
    double impact[3], impact_ms;
    double gravity[3], base[9];
} Machine;

static double uniform(Machine *m) {
    m->rng ^= m->rng << 13, m->rng ^= m->rng >> 7, m->rng ^= m->rng << 17;
    return ((double)(m->rng >> 11) + 0.5) / 9007199254740992.0;
}
static double normal(Machine *m) {
    double u = uniform(m);
    return sqrt(-2.0 * log(u)) * cos(2.0 * M_PI * uniform(m));
}
static double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }
static double sign(double x) { return (x > 0.0) - (x < 0.0); }
static int slot(int64_t ms, int n) { return (int)(((ms % n) + n) % n); }

/* Point (x, y, z) of the gripper's frame, or of the arm, in the arm plane's frame: position and velocity. */
typedef struct {
    double e1[2], e2[2], es[2], c, s, a1, a2, as, pin[2], pin_v[2], hub[2], hub_v[2];
} Chain;

static void chain(const Parameters *p, const double *q, const double *v, Chain *k) {
    double a1 = q[1], a2 = q[1] + q[2], as = a2 + q[4], length = p->tube_length[0] + p->pin_length[0] + q[3];
    k->e1[0] = cos(a1), k->e1[1] = sin(a1), k->e2[0] = cos(a2), k->e2[1] = sin(a2);
    k->es[0] = cos(as), k->es[1] = sin(as), k->c = cos(q[5]), k->s = sin(q[5]);
    k->a1 = v[1], k->a2 = v[1] + v[2], k->as = k->a2 + v[4];
    k->hub[0] = p->pivot[0] + p->boom_length[0] * k->e1[0], k->hub[1] = p->pivot[2] + p->boom_length[0] * k->e1[1];
    k->hub_v[0] = -p->boom_length[0] * k->a1 * k->e1[1], k->hub_v[1] = p->boom_length[0] * k->a1 * k->e1[0];
    k->pin[0] = k->hub[0] + p->tube_offset[0] * k->e2[0] + length * k->e2[1];
    k->pin[1] = k->hub[1] + p->tube_offset[0] * k->e2[1] - length * k->e2[0];
    k->pin_v[0] = k->hub_v[0] - p->tube_offset[0] * k->a2 * k->e2[1] + length * k->a2 * k->e2[0] + v[3] * k->e2[1];
    k->pin_v[1] = k->hub_v[1] + p->tube_offset[0] * k->a2 * k->e2[0] + length * k->a2 * k->e2[1] - v[3] * k->e2[0];
}

static void place(const double *o, const double *ov, const double *e, double rate, double x, double y, double z,
                  double xv, double yv, double zv, double axis_y, double slew_rate, double *at, double *speed) {
    at[0] = o[0] + x * e[0] - z * e[1], at[1] = axis_y + y, at[2] = o[1] + x * e[1] + z * e[0];
    double vx = ov[0] + rate * (-x * e[1] - z * e[0]) + xv * e[0] - zv * e[1];
    double vz = ov[1] + rate * (x * e[0] - z * e[1]) + xv * e[1] + zv * e[0];
    speed[0] = vx - slew_rate * at[1], speed[1] = yv + slew_rate * at[0], speed[2] = vz;
}

static void on_gripper(const Parameters *p, const Chain *k, const double *v, const double *at, double *x, double *u) {
    double y = at[1] * k->c - at[2] * k->s, z = at[1] * k->s + at[2] * k->c;
    place(k->pin, k->pin_v, k->es, k->as, at[0], y, z - p->roll_length[0], 0.0, -z * v[5], y * v[5], p->pivot[1],
          v[0], x, u);
}

static void load_place(const Machine *m, double *at) {
    at[0] = m->p.load_offset[0] + m->grasp[0] + m->shift, at[1] = m->p.load_offset[1] + m->grasp[1];
    at[2] = -m->p.grip_length[0] + m->grasp[2];
}

/* Velocities of all bodies, linear then angular in their own axes, six rows each; and their places. */
static void bodies(const Machine *m, const double *q, const double *v, double x[BODIES][3], double u[ROWS]) {
    const Parameters *p = &m->p;
    Chain k;
    chain(p, q, v, &k);
    double zero[2] = {0.0, 0.0}, base[2] = {p->pivot[0], p->pivot[2]}, y0 = p->pivot[1], at[3];
    place(base, zero, k.e1, k.a1, 1.149, 0, -0.084, 0, 0, 0, y0, v[0], x[0], u);
    place(k.hub, k.hub_v, k.e2, k.a2, 0.252, 0, -0.189, 0, 0, 0, y0, v[0], x[1], u + 6);
    double down = p->tube_length[0] + q[3] - 0.589;
    place(k.hub, k.hub_v, k.e2, k.a2, p->tube_offset[0], 0, -down, 0, 0, -v[3], y0, v[0], x[2], u + 12);
    place(k.pin, k.pin_v, k.es, k.as, 0, 0, -0.075, 0, 0, 0, y0, v[0], x[3], u + 18);
    at[0] = 0, at[1] = 0, at[2] = -p->gripper_com[0];
    on_gripper(p, &k, v, at, x[4], u + 24);
    load_place(m, at);
    on_gripper(p, &k, v, at, x[5], u + 30);
    const double *e[4] = {k.e1, k.e2, k.e2, k.es}, rate[4] = {k.a1, k.a2, k.a2, k.as};
    for (int b = 0; b < 4; b++)
        u[6 * b + 3] = v[0] * e[b][1], u[6 * b + 4] = -rate[b], u[6 * b + 5] = v[0] * e[b][0];
    for (int b = 4; b < 6; b++) {
        u[6 * b + 3] = v[0] * k.es[1] + v[5];
        u[6 * b + 4] = -k.as * k.c + v[0] * k.es[0] * k.s;
        u[6 * b + 5] = k.as * k.s + v[0] * k.es[0] * k.c;
    }
}

static double weight(const Machine *m, int row) {
    int b = row / 6, part = row % 6;
    if (b == 5 && !m->held) return 0.0;
    return part < 3 ? m->p.mass[b] : m->p.inertia[3 * b + part - 3];
}

static void mass_matrix(const Machine *m, const double *q, double M[6][6]) {
    double jacobian[6][ROWS], x[BODIES][3];
    for (int j = 0; j < 6; j++) {
        double unit[6] = {0};
        unit[j] = 1.0;
        bodies(m, q, unit, x, jacobian[j]);
    }
    memset(M, 0, 36 * sizeof(double));
    for (int r = 0; r < ROWS; r++) {
        double w = weight(m, r);
        for (int i = 0; i < 6; i++)
            for (int j = 0; j <= i; j++) M[i][j] += w * jacobian[i][r] * jacobian[j][r];
    }
    M[0][0] += m->p.upper_inertia[0];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < i; j++) M[j][i] = M[i][j];
}

static void energies(const Machine *m, const double *q, const double *v, double *kinetic, double *potential) {
    double x[BODIES][3], u[ROWS], c = cos(q[0]), s = sin(q[0]);
    bodies(m, q, v, x, u);
    *kinetic = 0.5 * m->p.upper_inertia[0] * v[0] * v[0], *potential = 0.0;
    for (int r = 0; r < ROWS; r++) *kinetic += 0.5 * weight(m, r) * u[r] * u[r];
    for (int b = 0; b < BODIES; b++) {
        double w = weight(m, 6 * b);
        *potential -= w * (m->gravity[0] * (c * x[b][0] - s * x[b][1]) + m->gravity[1] * (s * x[b][0] + c * x[b][1]) +
                           m->gravity[2] * x[b][2]);
    }
}

static void gradients(const Machine *m, const double *v, double *kinetic, double *potential) {
    const double step = 1e-5;
    for (int j = 0; j < 6; j++) {
        double q[6], t[2], u[2];
        memcpy(q, m->q, sizeof q);
        for (int i = 0; i < 2; i++) {
            q[j] = m->q[j] + (i ? step : -step);
            energies(m, q, v, &t[i], &u[i]);
        }
        kinetic[j] = (t[1] - t[0]) / (2.0 * step), potential[j] = (u[1] - u[0]) / (2.0 * step);
    }
}

static void solve(double M[6][6], const double *b, double *x) {
    double L[6][6];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            double sum = M[i][j];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    for (int i = 0; i < 6; i++) {
        x[i] = b[i];
        for (int k = 0; k < i; k++) x[i] -= L[i][k] * x[k];
        x[i] /= L[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++) x[i] -= L[k][i] * x[k];
        x[i] /= L[i][i];
    }
}

/* Lever arm dL/dq of a cylinder: base pin x, z of the parent, rod pin x, z of the child. */
static double lever(const double *pins, double angle) {
    double c = cos(angle), s = sin(angle), rx = c * pins[2] - s * pins[3], rz = s * pins[2] + c * pins[3];
    double dx = rx - pins[0], dz = rz - pins[1];
    return (dz * rx - dx * rz) / hypot(dx, dz);
}

/* Spools of one step: delay, play, first-order lag with a fastest stroke, overlap, notches; flow ratio -1..1. */
static void spools(Machine *m, double *flow) {
    const Parameters *p = &m->p;
    for (int j = 0; j < 4; j++) {
        int64_t late = llround(fmax(p->dead_time[j], 0.0) * 1e3);
        double asked = m->commands[slot(m->ms - late, HISTORY)][j];
        if (j == 2) asked = clip(asked + p->crossed_pilot[0] * m->commands[slot(m->ms - late, HISTORY)][1], -1, 1);
        m->played[j] = clip(m->played[j], asked - p->play[j], asked + p->play[j]);
        double target = m->played[j];
        if (p->sticking_spool[j] > 0.0 && m->sticks) {
            if (m->stick_until[j] == 0.0 && fabs(target) > 0.1) m->stick_until[j] = 1e-3 * m->ms + p->sticking_spool[j];
            if (1e-3 * m->ms < m->stick_until[j]) target = m->spool[j];
        }
        double lag = p->lag[j] + (fabs(target) < fabs(m->spool[j]) ? p->closing_lag[j] : 0.0);
        double change = (target - m->spool[j]) * H / fmax(lag, 0.004);
        m->spool[j] += clip(change, -H / p->stroke_s[j], H / p->stroke_s[j]);
        double x = m->spool[j], band = x > 0.0 ? p->band_positive[j] : p->band_negative[j];
        double open = fmax(fabs(x) - band, 0.0) / (1.0 - 0.04);
        open = fmin(open, 1.0);
        flow[j] = sign(x) * open * (1.0 - p->notch[j] + p->notch[j] * open);
    }
}

/* Speeds of the drives, m/s of the actuator: what the spools ask for, cut to what the pump gives. */
static void speeds(Machine *m, const double *arm, const double *load, double *flow, double *speed) {
    const Parameters *p = &m->p;
    double asked[4], burden[4], sum = 0.0, weighted = 0.0, highest = 2e6;
    for (int j = 0; j < 4; j++) {
        double s = flow[j], area = s > 0.0 ? p->area_positive[j] : p->area_negative[j];
        double full = s > 0.0 ? p->speed_positive[j] * p->gain_positive[j] : p->speed_negative[j] * p->gain_negative[j];
        double share = load[j] * sign(s) / p->largest_load[j];
        speed[j] = s * full * (1.0 - p->bypass[0] * clip(share, -1, 1) * (1.0 - fabs(s)));
        speed[j] *= 1.0 - p->load_loss[j] * clip(share, -1, 1);
        double rated = s > 0.0 ? p->rated_positive[j] : p->rated_negative[j];
        double limit = (1.0 - p->reduction[j]) * rated * fabs(arm[j]);
        if (p->reduction[j] > 0.0) speed[j] = clip(speed[j], -limit, limit);
        burden[j] = m->force[j] * sign(arm[j]) * sign(s) / area;
        if (fabs(s) > 0.02) highest = fmax(highest, burden[j]);
        asked[j] = fabs(speed[j]) * area, sum += asked[j];
        weighted += asked[j] * (1.0 - 0.4 * clip(burden[j] / 3.5e7, -1, 1));
    }
    m->pressure = fmin(highest + 1.5e6, 3.5e7);
    double most = p->pump_flow[0];
    if (p->weak_pump_under_pressure[0] > 0.0)
        most *= 1.0 - p->weak_pump_under_pressure[0] * clip((m->pressure - 4e6) / 6e6, 0, 1);
    most = fmin(most, p->pump_power[0] / m->pressure);
    m->pump += (fmin(most, p->pump_standby[0] + 1.05 * sum) - m->pump) * H / p->pump_lag[0];
    for (int j = 0; j < 4 && sum > m->pump; j++) {
        double mine = m->pump * asked[j] * (1.0 - 0.4 * clip(burden[j] / 3.5e7, -1, 1)) / weighted;
        if (asked[j] > 0.0) speed[j] *= fmin(mine / asked[j], 1.0);
    }
}

/* Dry friction of a joint now. */
static double dry_friction(const Machine *m, int j) {
    double dry = m->p.dry[j];
    if (j) return dry;
    if (cos(3.0 * (m->q[0] - 0.4)) > 0.3) dry += m->p.bad_sector[0];
    return m->brake_s < m->p.late_slew_brake[0] ? dry + 3.0e4 : dry;
}

static void step_body(Machine *m) {
    const Parameters *p = &m->p;
    double M[6][6], A[6][6], kinetic[6], potential[6], flow[4], speed[4], arm[4], free_[6], D[6] = {0}, b[6];
    double since = 1e-3 * (double)(m->ms - m->reset_ms);
    mass_matrix(m, m->q, M);
    solve(M, m->momentum, m->v);
    gradients(m, m->v, kinetic, potential);
    spools(m, flow);
    arm[0] = 1.0, arm[3] = 1.0;
    arm[1] = lever(p->boom_cylinder, m->q[1]), arm[2] = lever(p->dipper_cylinder, m->q[2]);
    speeds(m, arm, potential, flow, speed);
    double lock = fabs(flow[0]) < 0.005 ? -H : H, bristle[6], relax[6];
    m->brake_s = clip(m->brake_s + lock, 0.0, fmax(p->late_slew_brake[0], 1e-9));
    for (int j = 0; j < 6; j++) {
        free_[j] = kinetic[j] - potential[j];
        /* LuGre: bristles relax as the joint slides. */
        double dry = dry_friction(m, j), slide = m->v[j] / 0.02;
        double level = dry * (1.0 + p->static_ratio[0] * exp(-slide * slide));
        bristle[j] = dry / 0.0008;
        relax[j] = 1.0 / (1.0 + H * bristle[j] * fabs(m->v[j]) / fmax(level, 1e-9));
        free_[j] -= bristle[j] * relax[j] * m->bristle[j], D[j] += bristle[j] * relax[j] * H;
        D[j] += p->viscous[j];
    }
    for (int j = 0; j < 4; j++) {
        double out = m->q[j] - clip(m->q[j], p->stop_low[j], p->stop_high[j]);
        if (out != 0.0) free_[j] -= 4e6 * out, D[j] += 4e6 * H + 1e5;
    }
    const double about[2] = {275.0, 194.0};
    for (int i = 0; i < 2; i++) {
        double bend = m->q[4 + i] - m->start[4 + i];
        free_[4 + i] -= about[i] * (p->hose[0] * bend + p->stiffening_hose[0] * bend * bend * bend);
    }
    double keep[4], push[4];
    int state[4] = {0}; /* 0 elastic, +-1 at its relief valve, 2 in the play */
    for (int j = 0; j < 4; j++) {
        double open = clip(4.0 * fabs(flow[j]), 0.0, 1.0);
        double rigid = p->stiffness[j] / (1.0 + p->foaming_oil[0] * fmin(since / 2.0, 1.0));
        double leak = (open + (1.0 - open) / p->closed_factor[j]) / p->flow_damping[j];
        keep[j] = 1.0 / (1.0 + H * rigid * leak), push[j] = H * rigid * keep[j];
        speed[j] *= sign(arm[j]); /* of the actuator's own axis */
        if (p->gap[j] > 0.0 && fabs(m->slack[j]) < 0.5 * p->gap[j] && m->force[j] == 0.0) state[j] = 2;
    }
    double v[6];
    for (int round = 0; round < 3; round++) {
        memcpy(A, M, sizeof A);
        for (int j = 0; j < 6; j++) b[j] = m->momentum[j] + H * free_[j], A[j][j] += H * D[j];
        for (int j = 0; j < 4; j++) {
            A[j][j] += H * p->damper[j] * arm[j] * arm[j];
            if (state[j] == 2) continue;
            if (state[j]) b[j] += H * arm[j] * (state[j] > 0 ? p->force_positive[j] : -p->force_negative[j]);
            else {
                b[j] += H * arm[j] * (keep[j] * m->force[j] + push[j] * speed[j]);
                A[j][j] += H * push[j] * arm[j] * arm[j];
            }
        }
        solve(A, b, v);
        int again = 0;
        for (int j = 0; j < 4; j++) {
            double f = keep[j] * m->force[j] + push[j] * (speed[j] - arm[j] * v[j]);
            int want = state[j] == 2 ? 2 : f > p->force_positive[j] ? 1 : f < -p->force_negative[j] ? -1 : 0;
            again |= want != state[j], state[j] = want;
        }
        if (!again) break;
    }
    for (int j = 0; j < 4; j++) {
        double f = keep[j] * m->force[j] + push[j] * (speed[j] - arm[j] * v[j]);
        double before = m->force[j];
        m->force[j] = state[j] == 2 ? 0.0 : clip(f, -p->force_negative[j], p->force_positive[j]);
        if (p->gap[j] > 0.0) {
            double half = 0.5 * p->gap[j];
            if (state[j] == 2) {
                m->slack[j] += H * (speed[j] / arm[j] - v[j]);
                if (fabs(m->slack[j]) >= half) m->slack[j] = clip(m->slack[j], -half, half), m->force[j] = 1e-3 * sign(m->slack[j] * arm[j]);
            } else if (before * m->force[j] < 0.0) {
                m->slack[j] = 0.999 * half * sign(before * arm[j]), m->force[j] = 0.0;
            }
        }
    }
    for (int j = 0; j < 6; j++) {
        m->bristle[j] = relax[j] * (m->bristle[j] + H * v[j]);
        m->v[j] = v[j], m->q[j] += H * v[j];
        m->momentum[j] = 0.0;
        for (int i = 0; i < 6; i++) m->momentum[j] += M[j][i] * v[i];
    }
}

/* From frame `machine` to the surveyed, level frame; directions with point = 0. */
static void level(const Machine *m, const double *x, int point, double *y) {
    double z = x[2] - (point ? 0.85 : 0.0), t[3];
    for (int i = 0; i < 3; i++) t[i] = m->base[3 * i] * x[0] + m->base[3 * i + 1] * x[1] + m->base[3 * i + 2] * z;
    memcpy(y, t, sizeof t);
    if (point) y[2] += 0.85 + m->p.base[3];
}

static void turn(double slew, const double *x, double *y) {
    double c = cos(slew), s = sin(slew), t[3] = {c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]};
    memcpy(y, t, sizeof t);
}

static void release(Machine *m) {
    double at[3], x[3], u[3], M[6][6];
    Chain k;
    load_place(m, at);
    chain(&m->p, m->q, m->v, &k);
    on_gripper(&m->p, &k, m->v, at, x, u);
    u[1] += m->p.claw_kick[0];
    for (int i = 0; i < 3; i++) u[i] = u[i] * (1.0 - m->p.drag_on_claws[0]) + m->slip[i];
    turn(m->q[0], x, x), turn(m->q[0], u, u);
    level(m, x, 1, m->ball), level(m, u, 0, m->ball_speed);
    double across = fmax(hypot(m->ball_speed[0], m->ball_speed[1]), 1e-6);
    m->ball_spin[0] = m->p.spin[0] * m->ball_speed[1] / across, m->ball_spin[1] = -m->p.spin[0] * m->ball_speed[0] / across;
    m->ball_spin[2] = 0.0;
    m->held = 0, m->flying = 1, m->switch_ms = (double)m->ms + 20.0;
    mass_matrix(m, m->q, M);
    for (int j = 0; j < 6; j++) {
        m->momentum[j] = 0.0;
        for (int i = 0; i < 6; i++) m->momentum[j] += M[j][i] * m->v[i];
    }
}

/* Gripper cylinder: after its pilot delay it opens the claws; they free the load at 0.42 of their stroke. */
static void gripper(Machine *m, int open) {
    if (!open) {
        m->opened_s = 0.0, m->claw = fmax(m->claw - H / 0.4, 0.0);
        return;
    }
    m->opened_s += H;
    double late = m->p.open_delay[0] + m->release_noise;
    late += m->p.gripper_shares_pump[0] * clip(m->pump / 0.00367, 0, 1);
    if (m->opened_s > late) m->claw = fmin(m->claw + H * 0.42 / m->p.open_time[0], 1.0);
    if (m->held && m->claw >= 0.42) release(m);
}

static void air(const Machine *m, const double *x, const double *u, double *a) {
    const Parameters *p = &m->p;
    double w[3] = {p->wind[0] + p->wind_shear[0] * fmax(x[2], 0), p->wind[1], 0}, r[3], speed = 1e-9;
    for (int i = 0; i < 3; i++) r[i] = u[i] - w[i], speed += r[i] * r[i];
    speed = sqrt(speed);
    double reynolds = 2.0 * p->radius[0] * speed / 1.5e-5, mass = fmax(p->mass[5], 1e-3);
    double area = p->air[0] * M_PI * p->radius[0] * p->radius[0] / (2.0 * mass);
    double drag = p->drag[0] * (1.0 - 0.05 * tanh((reynolds - 1.2e5) / 5e4)) * area;
    double surface = p->radius[0] * fabs(p->spin[0]), lift = surface / (0.4 * speed + 2.32 * surface + 1e-9) * area;
    const double *s = m->ball_spin;
    double n = fmax(fabs(p->spin[0]), 1e-9), l[3] = {lift * s[0] / n, lift * s[1] / n, lift * s[2] / n};
    a[0] = -drag * speed * r[0] + speed * (l[1] * r[2] - l[2] * r[1]);
    a[1] = -drag * speed * r[1] + speed * (l[2] * r[0] - l[0] * r[2]);
    a[2] = -drag * speed * r[2] + speed * (l[0] * r[1] - l[1] * r[0]) - GRAVITY;
}

static void fly(Machine *m) {
    double a[3], x[3], u[3], floor_ = m->surface + m->p.radius[0], before = m->ball[2];
    air(m, m->ball, m->ball_speed, a);
    for (int i = 0; i < 3; i++) x[i] = m->ball[i] + 0.5 * H * m->ball_speed[i], u[i] = m->ball_speed[i] + 0.5 * H * a[i];
    air(m, x, u, a);
    for (int i = 0; i < 3; i++) m->ball[i] += H * u[i], m->ball_speed[i] += H * a[i];
    if (m->ms % BALL_MS == 0) {
        m->ball_ms = m->next_ms, memcpy(m->ball_seen, m->next_ball, sizeof m->ball_seen);
        m->next_ms = (double)m->ms;
        for (int i = 0; i < 3; i++) m->next_ball[i] = m->ball[i] + 0.015 * normal(m);
    }
    if ((m->ball[2] <= floor_ && before > floor_) || m->ball[2] < m->surface - 5.0) {
        double back = clip((floor_ - m->ball[2]) / fmax(before - m->ball[2], 1e-9), 0, 1);
        for (int i = 0; i < 2; i++) m->impact[i] = m->ball[i] - back * H * m->ball_speed[i] + 0.015 * normal(m);
        m->impact[2] = m->surface, m->impact_ms = (double)m->ms - round(back), m->flying = 0, m->landed = 1;
    }
}

static void gripper_axes(const Machine *m, double *R) {
    double as = m->q[1] + m->q[2] + m->q[4], c = cos(m->q[0]), s = sin(m->q[0]), ca = cos(as), sa = sin(as);
    double cr = cos(m->q[5]), sr = sin(m->q[5]);
    double x[3] = {ca, 0, sa}, y[3] = {-sa * sr, cr, ca * sr}, z[3] = {-sa * cr, -sr, ca * cr};
    const double *axes[3] = {x, y, z};
    for (int i = 0; i < 3; i++)
        R[3 * i] = c * axes[i][0] - s * axes[i][1], R[3 * i + 1] = s * axes[i][0] + c * axes[i][1], R[3 * i + 2] = axes[i][2];
}

static double quantise(double x, double step) { return step * round(x / step); }

static void sense(Machine *m) {
    const Parameters *p = &m->p;
    double R[9], x[3], u[3], since = fmax(1e-3 * (double)(m->ms - m->reset_ms), 0.0);
    memcpy(m->poses[slot(m->ms, HISTORY)], m->q, 4 * sizeof(double));
    if (m->ms % ENCODER_MS == 0) {
        for (int j = 0; j < 4; j++) {
            int64_t late = JOINT_LATE_MS + llround(fmax(p->joint_late[j], 0.0) * 1e3);
            double at = m->poses[slot(m->ms - late, HISTORY)][j] + p->position_bias[j] + p->encoder_noise[j] * normal(m);
            at = quantise(at, p->encoder_step[j]);
            /* tracking observer, 18 Hz */
            double dt = 1e-3 * ENCODER_MS, guess = m->observed[j] + dt * m->observed_speed[j], miss = at - guess;
            m->observed[j] = guess + 0.55 * miss, m->observed_speed[j] += 0.20 / dt * miss;
        }
        m->encoder_ms = (double)m->ms;
    }
    Chain k;
    chain(p, m->q, m->v, &k);
    on_gripper(p, &k, m->v, p->imu_place, x, u);
    turn(m->q[0], u, u), gripper_axes(m, R);
    for (int i = 0; i < 3; i++) {
        double a = (u[i] - m->imu_velocity[i]) / H - m->gravity[i];
        m->imu_velocity[i] = u[i], m->accel_filter[i] += (a - m->accel_filter[i]) * H / 0.012;
    }
    if (m->ms % IMU_MS == 0) {
        double turn_[3] = {0}, *kept = m->imu[slot(m->ms / IMU_MS, IMU_HISTORY)], w[3], f[3];
        double bend[BODIES][3], rows[ROWS];
        bodies(m, m->q, m->v, bend, rows);
        memcpy(turn_, rows + 27, sizeof turn_);
        double cx = cos(p->imu_angles[0]), sx = sin(p->imu_angles[0]), cy = cos(p->imu_angles[1]), sy = sin(p->imu_angles[1]);
        double cz = cos(p->imu_angles[2]), sz = sin(p->imu_angles[2]);
        double B[9] = {cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx, sz * cy, sz * sy * sx + cz * cx,
                       sz * sy * cx - cz * sx, -sy, cy * sx, cy * cx};
        for (int i = 0; i < 3; i++)
            f[i] = R[3 * i] * m->accel_filter[0] + R[3 * i + 1] * m->accel_filter[1] + R[3 * i + 2] * m->accel_filter[2];
        for (int i = 0; i < 3; i++) {
            m->wander[i] += p->gyro_drift[0] * normal(m);
            w[i] = B[i] * turn_[0] + B[3 + i] * turn_[1] + B[6 + i] * turn_[2];
            double g = B[i] * f[0] + B[3 + i] * f[1] + B[6 + i] * f[2];
            w[i] += p->gyro_bias[i] + m->wander[i] + 0.001 * normal(m) + (i == 1 ? p->drifting_gyro[0] * since : 0.0);
            kept[i] = quantise(w[i], 0.00107), kept[3 + i] = quantise(g + p->accel_bias[i] + 0.02 * normal(m), 0.0024);
        }
    }
}

static double box_distance(const double *x, double cx, double cy, double cz, double sx, double sy, double sz) {
    double dx = fmax(fabs(x[0] - cx) - sx, 0), dy = fmax(fabs(x[1] - cy) - sy, 0), dz = fmax(fabs(x[2] - cz) - sz, 0);
    return sqrt(dx * dx + dy * dy + dz * dz);
}

static void collide(Machine *m) {
    Chain k;
    double at[3] = {0, 0, -0.85}, x[3], u[3], y[3];
    chain(&m->p, m->q, m->v, &k);
    on_gripper(&m->p, &k, m->v, at, x, u);
    turn(m->q[0], x, y);
    if (x[2] < 0.4 || box_distance(y, 0, 0, 0.8, 2.3, 1.32, 0.55) < 0.4 ||
        box_distance(x, 0.27, 0.68, 2.094, 0.7, 0.44, 0.78) < 0.4 ||
        box_distance(x, -0.7, 0, 1.814, 1.25, 1.1, 0.52) < 0.4)
        m->collided = 1;
}

Machine *mule_new(int count) { return calloc((size_t)count, sizeof(Machine)); }
void mule_free(Machine *all) { free(all); }

void mule_configure(Machine *all, int index, const double *values) {
    Machine *m = all + index;
    memcpy(&m->p, values, sizeof m->p);
    double cr = cos(m->p.base[0]), sr = sin(m->p.base[0]), cp = cos(m->p.base[1]), sp = sin(m->p.base[1]);
    double cy = cos(m->p.base[2]), sy = sin(m->p.base[2]);
    double T[9] = {cp, sp * sr, sp * cr, 0, cr, -sr, -sp, cp * sr, cp * cr};
    for (int i = 0; i < 3; i++) {
        m->gravity[i] = -GRAVITY * T[6 + i];
        m->base[i] = cy * T[i] - sy * T[3 + i], m->base[3 + i] = sy * T[i] + cy * T[3 + i], m->base[6 + i] = T[6 + i];
    }
}

static void grasp(Machine *m) {
    for (int i = 0; i < 3; i++) m->grasp[i] = m->p.grasp[0] * normal(m), m->slip[i] = m->p.slip[0] * normal(m);
    m->release_noise = m->p.open_sd[0] * clip(normal(m), -3, 3);
    m->held = 1, m->flying = 0, m->landed = 0, m->shift = 0.0, m->claw = 0.0, m->opened_s = 0.0;
    m->impact_ms = 0, m->ball_ms = 0, m->next_ms = 0, m->switch_ms = 0;
}

void mule_reset(Machine *all, int index, const double *pose, uint64_t seed, int64_t ms) {
    Machine *m = all + index;
    double kinetic[6], potential[6];
    m->rng = seed | 1;
    for (int i = 0; i < 8; i++) uniform(m);
    m->ms = ms, m->reset_ms = ms, m->collided = 0, m->frozen = 0;
    m->sticks = uniform(m) < 1.0 / 3.0;
    grasp(m);
    for (int j = 0; j < 6; j++) {
        m->q[j] = pose[j] - (j < 4 ? m->p.position_bias[j] : 0.0);
        m->v[j] = m->momentum[j] = m->bristle[j] = 0.0, m->start[j] = m->q[j];
    }
    gradients(m, m->v, kinetic, potential);
    double arm[4] = {1.0, lever(m->p.boom_cylinder, m->q[1]), lever(m->p.dipper_cylinder, m->q[2]), 1.0};
    for (int j = 0; j < 4; j++) {
        m->force[j] = potential[j] / arm[j], m->slack[j] = 0.5 * m->p.gap[j] * sign(potential[j]);
        m->played[j] = m->spool[j] = m->stick_until[j] = 0.0;
        m->observed[j] = m->q[j] + m->p.position_bias[j], m->observed_speed[j] = 0.0;
    }
    if (m->p.gap[0] > 0.0) m->slack[0] = 0.0, m->force[0] = 0.0;
    m->pump = m->p.pump_standby[0], m->pressure = 3e6, m->brake_s = 0.0;
    for (int i = 0; i < HISTORY; i++) memset(m->commands[i], 0, sizeof m->commands[i]), memcpy(m->poses[i], m->q, sizeof m->poses[i]);
    for (int i = 0; i < 3; i++) m->imu_velocity[i] = 0.0, m->accel_filter[i] = -m->gravity[i], m->wander[i] = 0.0;
    for (int i = IMU_HISTORY - 1; i >= 0; i--) {
        m->ms = ms - ms % IMU_MS - (int64_t)i * IMU_MS;
        sense(m);
    }
    m->ms = ms, m->encoder_ms = (double)(ms - ms % ENCODER_MS);
}

void mule_reload(Machine *all, int index) {
    Machine *m = all + index;
    double M[6][6];
    if (m->held) return;
    grasp(m);
    mass_matrix(m, m->q, M);
    for (int j = 0; j < 6; j++) {
        m->momentum[j] = 0.0;
        for (int i = 0; i < 6; i++) m->momentum[j] += M[j][i] * m->v[i];
    }
}

void mule_set(Machine *all, int index, double surface, int frozen) { all[index].surface = surface, all[index].frozen = frozen; }

void mule_advance(Machine *all, int count, const double *valves, const uint8_t *open, int64_t ms, int ticks) {
    for (int index = 0; index < count; index++) {
        Machine *m = all + index;
        for (int64_t step = 0; step < 10 * (int64_t)ticks; step++) {
            m->ms = ms + step;
            if (m->frozen) {
                m->ms++;
                m->encoder_ms = (double)(m->ms - m->ms % ENCODER_MS);
                continue;
            }
            for (int j = 0; j < 4; j++) m->commands[slot(m->ms, HISTORY)][j] = clip(valves[4 * index + j], -1, 1);
            step_body(m);
            m->ms++;
            if (m->held) {
                double swing = m->q[1] + m->q[2] + m->q[4];
                double goal = m->p.shifting_load[0] * clip(6.0 * swing, -1, 1);
                m->shift += (goal - m->shift) * H / 0.25;
            }
            gripper(m, open[index]);
            if (m->flying) fly(m);
            sense(m);
            if (m->ms % 10 == 0) collide(m);
        }
    }
}

void mule_read(const Machine *all, int count, Output *out) {
    for (int index = 0; index < count; index++) {
        const Machine *m = all + index;
        Output *o = out + index;
        memset(o, 0, sizeof *o);
        o->joint_time = m->encoder_ms - JOINT_LATE_MS;
        memcpy(o->position, m->observed, sizeof o->position), memcpy(o->velocity, m->observed_speed, sizeof o->velocity);
        int64_t seen = (m->ms - IMU_LATE_MS) / IMU_MS, old = (m->ms - IMU_LATE_MS - llround(m->p.imu_late[0] * 1e3)) / IMU_MS;
        const double *imu = m->imu[slot(old, IMU_HISTORY)];
        o->imu_time = (double)(seen * IMU_MS), memcpy(o->gyro, imu, 24), memcpy(o->accel, imu + 3, 24);
        o->held = m->held || (m->switch_ms > 0 && (double)m->ms < m->switch_ms), o->pressure = m->pressure;
        if (m->flying && m->ball_ms > 0) o->ball_time = m->ball_ms, memcpy(o->ball, m->ball_seen, 24);
        if (m->landed && (double)m->ms > m->impact_ms + 600.0) o->impact_time = m->impact_ms, memcpy(o->impact, m->impact, 24);
        o->collided = m->collided, memcpy(o->true_position, m->q, sizeof o->true_position);
    }
}

void mule_mass(const Machine *all, int index, double *mass, double *gravity) {
    double M[6][6], kinetic[6];
    const double rest[6] = {0};
    mass_matrix(all + index, all[index].q, M), memcpy(mass, M, sizeof M);
    gradients(all + index, rest, kinetic, gravity);
}
