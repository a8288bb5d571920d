/* Independent plant `ring`: rigid arm, load-sensing hydraulics, sensors and flight, RK4 at 0.5 ms.
 *
 * Frames, signs and joint order: docs/machine.md. SI units. README.md beside this file describes the physics.
 * The parameters are one block of doubles; ring_parameter_names() lists its fields for the caller.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define DRIVEN 4
#define JOINTS 6
#define BODIES 7 /* upper carriage, boom, dipper, telescope, hanger, gripper, load */
#define STEP_S 0.0005
#define STEPS_A_TICK 20
#define DELAY_STEPS 2048
#define SAMPLES 128
#define PI 3.14159265358979323846

/* S: a number. V: an array. Effects hold the values of docs/effects.md; 0 is no effect. */
#define PARAMETERS(S, V) \
    S(slew_height) V(boom_pivot, 3) S(boom_length) S(telescope_offset) S(dipper_length) S(tool_length) \
    S(hanger_length) S(grip_length) V(imu_place, 3) \
    V(mass, 6) V(com, 18) V(inertia, 18) \
    S(load_mass) S(load_radius) S(load_drag) S(air_density) V(wind, 2) V(base_turn, 3) S(base_height) \
    V(position_min, 4) V(position_max, 4) V(rated_positive, 4) V(rated_negative, 4) \
    V(cylinder_base, 4) V(cylinder_rod, 4) V(area_positive, 4) V(area_negative, 4) \
    S(pump_flow) S(pump_pressure) S(pump_margin) S(pump_lag) \
    V(full_positive, 4) V(full_negative, 4) V(notch_curve, 4) \
    V(dead_time, 4) V(pilot_frequency, 4) V(pilot_damping, 4) V(spool_lag, 4) V(band_positive, 4) V(band_negative, 4) \
    V(oil_frequency, 4) V(oil_damping, 4) V(torque_limit, 4) V(leak_rate, 4) \
    V(coulomb, 4) V(breakaway, 4) V(viscous, 4) S(stribeck_speed) \
    S(swing_viscous) S(swing_coulomb) S(swing_breakaway) S(swing_inertia_pitch) S(swing_inertia_roll) S(hose) \
    S(release_delay) S(release_sd) S(release_slowdown) S(release_spin) V(load_offset, 2) \
    V(joint_bias, 4) V(joint_latency, 4) V(quantum, 4) V(imu_turn, 3) S(imu_latency) V(gyro_bias, 3) V(accel_bias, 3) \
    V(gain_positive, 4) V(gain_negative, 4) V(play, 4) V(limit_reduction, 4) V(load_loss, 4) \
    V(stick_share, 4) V(stick_time, 4) S(engine_sag) S(half_open) S(ring_drag) S(ring_drag_angle) V(position_gain, 4) \
    V(air_in_oil, 4) S(pressure_hunting) V(slow_opening, 4) S(noise)

#define STRUCT_S(name) double name;
#define STRUCT_V(name, n) double name[n];
typedef struct { PARAMETERS(STRUCT_S, STRUCT_V) } Parameters;
#define NAME_S(name) #name ":0,"
#define NAME_V(name, n) #name ":" #n ","
const char *ring_parameter_names(void) { return PARAMETERS(NAME_S, NAME_V); }

/* What the driver reads: the fields of runtime/driver.py :: SensorSample, times in s of the plant's clock. */
typedef struct {
    double joint_time, position[4], velocity[4], imu_time, gyro[3], accel[3], held, pressure;
    double ball_time, ball[3], impact_time, impact[3], collided, true_position[6];
} Output;

enum { Q = 0, QD = 6, PILOT = 12, PILOT_D = 16, SPOOL = 20, DEFLECTION = 24, PUMP = 28, ENGINE = 29, STATES = 30 };

typedef struct { double time, position[4], velocity[4]; } JointSample;
typedef struct { double time, gyro[3], accel[3]; } ImuSample;

typedef struct {
    Parameters p;
    double x[STATES];
    double stiffness[4], damping[4];
    double gravity[3], turn[9]; /* gravity in frame `machine`; rotation of the machine against the survey */
    double command[4], played[4], spool_target[4], delayed[DELAY_STEPS][4];
    long step, sample_count, imu_count;
    double stuck_until[4], hold_angle[2], hold_pose[2];
    int sticks, was_moved[4], frozen, is_open, load; /* load: 0 in the claws, 1 in the air, 2 down, 3 none */
    double opened_at, delay, released_at, landed_at;
    double flight[6], surface, throw_gain[4];
    double filtered[4], quantised[4], speed[4], imu_filtered[6];
    JointSample joints[SAMPLES];
    ImuSample imu[SAMPLES];
    double ball_samples[8][4];
    long ball_count;
    double impact[3], impact_time;
    int collided;
    uint64_t rng;
    double time;
} Machine;

/* --- numbers ------------------------------------------------------------------------------------- */
static double uniform(Machine *m) {
    uint64_t z = (m->rng += 0x9E3779B97F4A7C15ull);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    return ((double)((z ^ (z >> 31)) >> 11) + 0.5) / 9007199254740992.0;
}
static double normal(Machine *m) { return sqrt(-2.0 * log(uniform(m))) * cos(2.0 * PI * uniform(m)); }
static double clamp(double v, double low, double high) { return v < low ? low : v > high ? high : v; }
static void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}
static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static void turn(const double *r, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2];
}
static void turn_back(const double *r, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2];
}
static void multiply(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}
static void rotation(int axis, double angle, double *r) {
    double c = cos(angle), s = sin(angle);
    int i = (axis + 1) % 3, j = (axis + 2) % 3;
    memset(r, 0, 9 * sizeof(double));
    r[4 * axis] = 1.0;
    r[4 * i] = r[4 * j] = c;
    r[3 * i + j] = -s;
    r[3 * j + i] = s;
}

/* --- rigid bodies -------------------------------------------------------------------------------- */
typedef struct {
    double origin[JOINTS][3], axis[JOINTS][3]; /* of each joint; the telescope slides along its axis */
    double r[JOINTS][9], w[JOINTS][3], alpha[JOINTS][3], a[JOINTS][3], v[JOINTS][3]; /* of each body's origin */
} Chain;

/* Poses, speeds and accelerations of all bodies; gravity enters as an acceleration of the base. */
static void chain_motion(const Machine *m, const double *q, const double *qd, const double *qdd, Chain *c) {
    static const int axes[JOINTS] = {2, 1, 1, -1, 1, 0};
    static const double signs[JOINTS] = {1, -1, -1, -1, -1, 1};
    const Parameters *p = &m->p;
    double offsets[JOINTS][3] = {
        {0, 0, p->slew_height}, {p->boom_pivot[0], p->boom_pivot[1], p->boom_pivot[2]}, {p->boom_length, 0, 0},
        {p->telescope_offset, 0, -p->dipper_length - q[3]}, {0, 0, -p->tool_length}, {0, 0, -p->hanger_length}};
    double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, w[3] = {0}, al[3] = {0}, o[3] = {0}, v[3] = {0};
    double a[3] = {-m->gravity[0], -m->gravity[1], -m->gravity[2]}, t[3], u[3], d[3];
    for (int j = 0; j < JOINTS; j++) {
        turn(r, offsets[j], d);
        cross(w, d, t);
        cross(w, t, u);
        double e[3];
        cross(al, d, e);
        for (int k = 0; k < 3; k++) {
            o[k] += d[k];
            v[k] += t[k];
            a[k] += e[k] + u[k];
        }
        if (axes[j] < 0) {
            double slide[3] = {-r[2], -r[5], -r[8]};
            cross(w, slide, t);
            for (int k = 0; k < 3; k++) {
                c->axis[j][k] = slide[k];
                v[k] += slide[k] * qd[j];
                a[k] += 2.0 * t[k] * qd[j] + slide[k] * qdd[j];
            }
        } else {
            double axis[3] = {signs[j] * r[axes[j]], signs[j] * r[3 + axes[j]], signs[j] * r[6 + axes[j]]};
            double step[9], next[9];
            cross(w, axis, t);
            for (int k = 0; k < 3; k++) {
                c->axis[j][k] = axis[k];
                al[k] += t[k] * qd[j] + axis[k] * qdd[j];
                w[k] += axis[k] * qd[j];
            }
            rotation(axes[j], signs[j] * q[j], step);
            multiply(r, step, next);
            memcpy(r, next, sizeof r);
        }
        memcpy(c->origin[j], o, sizeof o);
        memcpy(c->r[j], r, sizeof r);
        memcpy(c->w[j], w, sizeof w);
        memcpy(c->alpha[j], al, sizeof al);
        memcpy(c->a[j], a, sizeof a);
        memcpy(c->v[j], v, sizeof v);
    }
}

/* Acceleration and speed of a point of body b at `place` in its frame. */
static void point_motion(const Chain *c, int b, const double *place, double *position, double *speed, double *accel) {
    double d[3], t[3], u[3], e[3];
    turn(c->r[b], place, d);
    cross(c->w[b], d, t);
    cross(c->w[b], t, u);
    cross(c->alpha[b], d, e);
    for (int k = 0; k < 3; k++) {
        position[k] = c->origin[b][k] + d[k];
        speed[k] = c->v[b][k] + t[k];
        accel[k] = c->a[b][k] + e[k] + u[k];
    }
}

/* Mass matrix and bias forces (gravity, centrifugal, Coriolis) by projecting Newton-Euler on the joints. */
static void mass_and_bias(const Machine *m, const double *q, const double *qd, double mass[JOINTS][JOINTS], double *bias) {
    static const double zero[JOINTS] = {0};
    const Parameters *p = &m->p;
    Chain c;
    chain_motion(m, q, qd, zero, &c);
    memset(mass, 0, sizeof(double) * JOINTS * JOINTS);
    memset(bias, 0, sizeof(double) * JOINTS);
    for (int b = 0; b < BODIES; b++) {
        if (b == 6 && m->load != 0) continue;
        int body = b < 6 ? b : 5;
        double load_place[3] = {p->load_offset[0], p->load_offset[1], -p->grip_length};
        const double *com = b < 6 ? p->com + 3 * b : load_place;
        double kg = b < 6 ? p->mass[b] : p->load_mass, ball = 0.4 * kg * p->load_radius * p->load_radius;
        double inertia[3] = {ball, ball, ball};
        if (b < 6) memcpy(inertia, p->inertia + 3 * b, sizeof inertia);
        double place[3], speed[3], accel[3], wl[3], al[3], local[3], gyroscopic[3], torque[3];
        point_motion(&c, body, com, place, speed, accel);
        turn_back(c.r[body], c.w[body], wl);
        turn_back(c.r[body], c.alpha[body], al);
        double spin[3] = {inertia[0] * wl[0], inertia[1] * wl[1], inertia[2] * wl[2]};
        cross(wl, spin, gyroscopic);
        for (int k = 0; k < 3; k++) local[k] = inertia[k] * al[k] + gyroscopic[k];
        turn(c.r[body], local, torque);
        double linear[JOINTS][3], angular[JOINTS][3], scaled[JOINTS][3];
        for (int j = 0; j <= body; j++) {
            if (j == 3) {
                memcpy(linear[j], c.axis[j], sizeof linear[j]);
                memset(angular[j], 0, sizeof angular[j]);
            } else {
                double d[3] = {place[0] - c.origin[j][0], place[1] - c.origin[j][1], place[2] - c.origin[j][2]};
                cross(c.axis[j], d, linear[j]);
                turn_back(c.r[body], c.axis[j], angular[j]);
            }
            for (int k = 0; k < 3; k++) scaled[j][k] = inertia[k] * angular[j][k];
            bias[j] += kg * dot(linear[j], accel) + (j == 3 ? 0.0 : dot(c.axis[j], torque));
            for (int i = 0; i <= j; i++) mass[i][j] += kg * dot(linear[i], linear[j]) + dot(angular[i], scaled[j]);
        }
    }
    for (int i = 0; i < JOINTS; i++)
        for (int j = 0; j < i; j++) mass[i][j] = mass[j][i];
}

static void solve(double a[JOINTS][JOINTS], double *b) { /* Cholesky; the answer replaces b */
    for (int j = 0; j < JOINTS; j++) {
        for (int k = 0; k < j; k++) a[j][j] -= a[j][k] * a[j][k];
        a[j][j] = sqrt(a[j][j]);
        for (int i = j + 1; i < JOINTS; i++) {
            for (int k = 0; k < j; k++) a[i][j] -= a[i][k] * a[j][k];
            a[i][j] /= a[j][j];
        }
    }
    for (int i = 0; i < JOINTS; i++) {
        for (int k = 0; k < i; k++) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = JOINTS - 1; i >= 0; i--) {
        for (int k = i + 1; k < JOINTS; k++) b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
}

/* --- hydraulics ---------------------------------------------------------------------------------- */
/* Cylinder travel a radian of the joint, m; 1 for slew and telescope. */
static double moment_arm(const Parameters *p, int joint, double angle) {
    if (joint == 0 || joint == 3) return 1.0;
    const double *base = p->cylinder_base + 2 * (joint - 1), *rod = p->cylinder_rod + 2 * (joint - 1);
    double x = cos(angle) * rod[0] - sin(angle) * rod[1], z = sin(angle) * rod[0] + cos(angle) * rod[1];
    double dx = x - base[0], dz = z - base[1];
    return fmax(fabs((-z * dx + x * dz) / sqrt(dx * dx + dz * dz)), 0.05);
}

static double stribeck(double v, double coulomb, double breakaway, double speed, double width) {
    return (coulomb + (breakaway - coulomb) * exp(-(v / speed) * (v / speed))) * tanh(v / width);
}

/* Torque of the drives on the four joints, and the rates of their states. */
static void drives(const Machine *m, const double *x, double *torque, double *dx) {
    const Parameters *p = &m->p;
    static const double gravity_moment[4] = {1e12, 69.7e3, 27.7e3, 7.85e3}; /* docs/machine.md */
    double flow[4], ratio[4], pressure[4], arm[4], need = 0.0, highest = 0.0;
    for (int j = 0; j < DRIVEN; j++) {
        double pilot = x[PILOT + j], s = x[SPOOL + j], size = fabs(s);
        double w = 2.0 * PI * p->pilot_frequency[j];
        dx[PILOT + j] = x[PILOT_D + j];
        dx[PILOT_D + j] = w * w * (m->spool_target[j] - pilot) - 2.0 * p->pilot_damping[j] * w * x[PILOT_D + j];
        dx[SPOOL + j] = (pilot - s) / p->spool_lag[j];
        double band = s > 0 ? p->band_positive[j] : p->band_negative[j];
        double open = size <= band ? 0.0 : (size - band) / (1.0 - band);
        double notch = open * (1.0 - p->notch_curve[j] * (1.0 - open));
        double middle = j == 0 ? 0.0 : 0.5 * (p->position_min[j] + p->position_max[j]);
        double half = j == 0 ? PI : 0.5 * (p->position_max[j] - p->position_min[j]);
        double where = j == 0 ? sin(x[Q]) : clamp((x[Q + j] - middle) / half, -1.0, 1.0);
        double gain = (1.0 + p->position_gain[j] * where) * m->throw_gain[j];
        gain *= 1.0 + (s > 0 ? p->gain_positive[j] : p->gain_negative[j]);
        flow[j] = (s > 0 ? p->full_positive[j] : -p->full_negative[j]) * notch * gain;
        arm[j] = moment_arm(p, j, x[Q + j]);
        double area = flow[j] > 0 ? p->area_positive[j] : p->area_negative[j];
        double force = m->stiffness[j] * x[DEFLECTION + j] / arm[j] * (flow[j] > 0 ? 1.0 : -1.0);
        pressure[j] = clamp(force / area, 0.0, p->pump_pressure);
        highest = fmax(highest, pressure[j] * fmin(1.0, fabs(notch) / 0.02));
    }
    for (int j = 0; j < DRIVEN; j++) {
        double area = flow[j] > 0 ? p->area_positive[j] : p->area_negative[j];
        double drop = clamp((x[PUMP] - pressure[j]) / p->pump_margin, 0.0, 1.0);
        ratio[j] = drop < 0.05 ? drop / sqrt(0.05) : sqrt(drop);
        ratio[j] *= 1.0 - 0.03 * pressure[j] / p->pump_pressure;
        need += fabs(flow[j]) * ratio[j] * area;
    }
    /* Load-sensing pump: pressure margin above the highest load; where flow runs out the margin falls. */
    double hunting = p->pressure_hunting * p->pump_margin * sin(2.0 * PI * 1.4 * m->time);
    double wanted = fmin(p->pump_pressure, highest + p->pump_margin + hunting);
    double available = p->pump_flow * x[ENGINE];
    dx[PUMP] = (wanted - x[PUMP]) / p->pump_lag - 8.0e8 * fmax(0.0, need / available - 1.0);
    /* Engine: its speed falls with the power drawn and comes back in 0.6 s. */
    double load = fmin(need, available) * x[PUMP] / (p->pump_flow * p->pump_pressure);
    dx[ENGINE] = ((1.0 - p->engine_sag * load) - x[ENGINE]) / 0.6;
    if (x[ENGINE] < 0.3 && dx[ENGINE] < 0) dx[ENGINE] = 0;
    for (int j = 0; j < DRIVEN; j++) {
        double v = flow[j] * ratio[j] / arm[j], qd = x[QD + j];
        if (p->load_loss[j] != 0) v *= 1.0 - p->load_loss[j] * clamp(m->stiffness[j] * x[DEFLECTION + j] / gravity_moment[j], -1.0, 1.0) * (v > 0 ? 1 : -1);
        double rated = (v > 0 ? p->rated_positive[j] : p->rated_negative[j]) * (1.0 - p->limit_reduction[j]);
        if (p->limit_reduction[j] > 0) v = clamp(v, -rated, rated);
        double k = m->stiffness[j] * (1.0 - p->air_in_oil[j]), limit = p->torque_limit[j];
        double raw = k * x[DEFLECTION + j] + m->damping[j] * (v - qd);
        torque[j] = clamp(raw, -limit, limit);
        double rate = v - qd - p->leak_rate[j] * x[DEFLECTION + j];
        /* Relief valves: oil beyond the limit leaves. */
        if ((raw > limit && rate > 0) || (raw < -limit && rate < 0)) rate = 0.0;
        dx[DEFLECTION + j] = rate;
    }
}

static void derivative(const Machine *m, const double *x, double *dx) {
    const Parameters *p = &m->p;
    double mass[JOINTS][JOINTS], bias[JOINTS], tau[JOINTS] = {0};
    mass_and_bias(m, x + Q, x + QD, mass, bias);
    drives(m, x, tau, dx);
    for (int j = 0; j < DRIVEN; j++) {
        double v = x[QD + j], drag = j == 0 ? p->ring_drag * (0.5 + 0.5 * cos(x[Q] - p->ring_drag_angle)) : 0.0;
        tau[j] -= stribeck(v, p->coulomb[j] + drag, p->breakaway[j] + drag, p->stribeck_speed, 0.004) + p->viscous[j] * v;
        if (j == 0) continue;
        double over = x[Q + j] - clamp(x[Q + j], p->position_min[j], p->position_max[j]);
        if (over != 0) tau[j] -= 2.0e6 * over + 4.0e4 * v; /* end stop */
    }
    double inertia[2] = {p->swing_inertia_pitch, p->swing_inertia_roll};
    for (int j = 4; j < 6; j++) {
        double v = x[QD + j];
        tau[j] -= inertia[j - 4] * (stribeck(v, p->swing_coulomb, p->swing_breakaway, 0.05, 0.008) +
                  p->swing_viscous * v + p->hose * (x[Q + j] - m->hold_angle[j - 4]));
    }
    for (int j = 0; j < JOINTS; j++) tau[j] -= bias[j];
    solve(mass, tau);
    memcpy(dx + Q, x + QD, JOINTS * sizeof(double));
    memcpy(dx + QD, tau, JOINTS * sizeof(double));
}

/* --- load ---------------------------------------------------------------------------------------- */
static void to_survey(const Machine *m, const double *v, double *out, int is_place) {
    double t[3] = {v[0], v[1], v[2] - (is_place ? 0.85 : 0.0)};
    turn(m->turn, t, out);
    if (is_place) out[2] += 0.85 + m->p.base_height;
}

static void let_go(Machine *m) {
    static const double zero[JOINTS] = {0};
    const Parameters *p = &m->p;
    Chain c;
    double grip[3] = {p->load_offset[0], p->load_offset[1], -p->grip_length}, place[3], speed[3], accel[3];
    chain_motion(m, m->x + Q, m->x + QD, zero, &c);
    point_motion(&c, 5, grip, place, speed, accel);
    for (int k = 0; k < 3; k++) speed[k] *= 1.0 - p->release_slowdown;
    if (p->half_open != 0) { /* The load slides off one claw: its speed is deflected towards the other. */
        double local[3];
        turn_back(c.r[5], speed, local);
        double along = local[0] * cos(p->half_open), lifted = fabs(local[0]) * sin(p->half_open);
        local[0] = along;
        local[2] += lifted;
        local[1] += 0.3 * lifted;
        turn(c.r[5], local, speed);
    }
    to_survey(m, place, m->flight, 1);
    to_survey(m, speed, m->flight + 3, 0);
    m->load = 1;
    m->released_at = m->time;
}

static void fly(Machine *m) {
    const Parameters *p = &m->p;
    double k = 0.5 * p->air_density * p->load_drag * PI * p->load_radius * p->load_radius / p->load_mass;
    double *f = m->flight, mid[6], now[6];
    memcpy(now, f, sizeof now);
    for (int stage = 0; stage < 2; stage++) {
        const double *s = stage ? mid : now;
        double h = stage ? STEP_S : 0.5 * STEP_S;
        double air[3] = {s[3] - p->wind[0], s[4] - p->wind[1], s[5]}, v = sqrt(dot(air, air)), a[3];
        for (int i = 0; i < 3; i++) a[i] = -k * v * air[i];
        if (p->release_spin != 0 && v > 0.1) {
            double spin[3] = {now[4], -now[3], 0}, length = hypot(now[3], now[4]), lift[3];
            double s_ratio = fabs(p->release_spin) * p->load_radius / v;
            double size = k / p->load_drag * v * s_ratio / (0.4 + 2.32 * s_ratio) * (p->release_spin > 0 ? 1 : -1);
            cross(spin, air, lift);
            for (int i = 0; i < 3; i++) a[i] += size * lift[i] / fmax(length, 1e-6);
        }
        a[2] -= 9.81;
        double *out = stage ? f : mid;
        for (int i = 0; i < 3; i++) {
            out[i] = now[i] + h * s[3 + i];
            out[3 + i] = now[3 + i] + h * a[i];
        }
    }
    double floor = m->surface + p->load_radius;
    if (f[2] <= floor && f[5] < 0) {
        double part = clamp((now[2] - floor) / fmax(now[2] - f[2], 1e-9), 0.0, 1.0);
        for (int i = 0; i < 2; i++) m->impact[i] = now[i] + part * (f[i] - now[i]) + m->p.noise * 0.02 * normal(m);
        m->impact[2] = m->surface;
        m->impact_time = m->time + part * STEP_S;
        m->load = 2;
    }
}

/* --- sensors ------------------------------------------------------------------------------------- */
static void sense(Machine *m, long step) {
    const Parameters *p = &m->p;
    for (int j = 0; j < DRIVEN; j++) m->filtered[j] += (m->x[Q + j] - m->filtered[j]) * STEP_S / 0.006;
    if (step % 10 == 0) { /* encoders, 200 Hz */
        JointSample *s = &m->joints[m->sample_count++ % SAMPLES];
        s->time = m->time;
        for (int j = 0; j < DRIVEN; j++) {
            double jitter = p->noise * (uniform(m) - 0.5);
            double read = p->quantum[j] * floor((m->filtered[j] + p->joint_bias[j]) / p->quantum[j] + 0.5 + jitter);
            m->speed[j] += ((read - m->quantised[j]) / 0.005 - m->speed[j]) * 0.3;
            m->quantised[j] = s->position[j] = read;
            s->velocity[j] = m->speed[j];
        }
    }
    if (step % 2 == 0) { /* IMU: filter, then 100 Hz */
        double dx[STATES], place[3], speed[3], accel[3], local[6], r[9], t[9], mount[9];
        Chain c;
        derivative(m, m->x, dx);
        chain_motion(m, m->x + Q, m->x + QD, dx + QD, &c);
        point_motion(&c, 5, p->imu_place, place, speed, accel);
        turn_back(c.r[5], c.w[5], local);
        turn_back(c.r[5], accel, local + 3);
        for (int k = 0; k < 6; k++) m->imu_filtered[k] += (local[k] - m->imu_filtered[k]) * 2.0 * STEP_S / 0.008;
        if (step % 20 == 0) {
            ImuSample *s = &m->imu[m->imu_count++ % SAMPLES];
            rotation(2, p->imu_turn[2], r);
            rotation(1, p->imu_turn[1], t);
            multiply(r, t, mount);
            rotation(0, p->imu_turn[0], t);
            multiply(mount, t, r);
            s->time = m->time;
            turn_back(r, m->imu_filtered, s->gyro);
            turn_back(r, m->imu_filtered + 3, s->accel);
            for (int k = 0; k < 3; k++) {
                s->gyro[k] += p->gyro_bias[k] + p->noise * 0.003 * normal(m);
                s->accel[k] += p->accel_bias[k] + p->noise * 0.06 * normal(m);
            }
        }
    }
    if (step % 40 == 0 && m->load == 1) { /* load tracker, 50 Hz */
        double *s = m->ball_samples[m->ball_count++ % 8];
        s[0] = m->time;
        for (int k = 0; k < 3; k++) s[1 + k] = m->flight[k] + m->p.noise * 0.02 * normal(m);
    }
}

static double segment_distance(const double *a, const double *b, const double *point) {
    double d[3], e[3];
    for (int k = 0; k < 3; k++) d[k] = b[k] - a[k], e[k] = point[k] - a[k];
    double t = clamp(dot(d, e) / dot(d, d), 0.0, 1.0);
    for (int k = 0; k < 3; k++) e[k] -= t * d[k];
    return sqrt(dot(e, e));
}

static void check_collision(Machine *m) {
    static const double zero[JOINTS] = {0};
    Chain c;
    double claws[3] = {0, 0, -0.85}, place[3], speed[3], accel[3], tip[3], low[3] = {0, 0, -0.5};
    chain_motion(m, m->x + Q, m->x + QD, zero, &c);
    point_motion(&c, 5, claws, place, speed, accel);
    point_motion(&c, 3, low, tip, speed, accel);
    int hit = place[2] < 0.4 || segment_distance(c.origin[2], tip, place) < 0.53 ||
              segment_distance(c.origin[1], c.origin[2], place) < 0.6;
    double outside[3] = {fmax(fabs(place[0]) - 2.3, 0), fmax(fabs(place[1]) - 1.32, 0), fmax(place[2] - 1.35, 0)};
    if (hit || dot(outside, outside) < 0.16) m->collided = 1;
}

/* --- one step ------------------------------------------------------------------------------------ */
static void commands(Machine *m) {
    const Parameters *p = &m->p;
    memcpy(m->delayed[m->step % DELAY_STEPS], m->command, sizeof m->command);
    for (int j = 0; j < DRIVEN; j++) {
        long late = (long)(clamp(p->dead_time[j], 0.0, 1.0) / STEP_S + 0.5);
        double u = m->delayed[(m->step + DELAY_STEPS - late) % DELAY_STEPS][j];
        m->played[j] = p->play[j] > 0 ? clamp(m->played[j], u - p->play[j], u + p->play[j]) : u;
        double target = m->played[j];
        if (m->sticks && p->stick_time[j] > 0) { /* The spool sticks in its centre at its first move. */
            if (!m->was_moved[j] && fabs(target) > 0.08) {
                m->was_moved[j] = 1;
                m->stuck_until[j] = m->time + p->stick_time[j];
            }
            if (m->time < m->stuck_until[j]) target = 0.0;
        }
        /* A spool that opens slowly and closes at once: a throttled pilot line with a check valve. */
        m->spool_target[j] += p->slow_opening[j] > 0
            ? (target - m->spool_target[j]) * (fabs(target) > fabs(m->spool_target[j]) ? STEP_S / p->slow_opening[j] : 1.0)
            : target - m->spool_target[j];
    }
}

static void one_step(Machine *m) {
    double k1[STATES], k2[STATES], k3[STATES], k4[STATES], y[STATES], *x = m->x;
    commands(m);
    derivative(m, x, k1);
    for (int i = 0; i < STATES; i++) y[i] = x[i] + 0.5 * STEP_S * k1[i];
    derivative(m, y, k2);
    for (int i = 0; i < STATES; i++) y[i] = x[i] + 0.5 * STEP_S * k2[i];
    derivative(m, y, k3);
    for (int i = 0; i < STATES; i++) y[i] = x[i] + STEP_S * k3[i];
    derivative(m, y, k4);
    for (int i = 0; i < STATES; i++) x[i] += STEP_S / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    if (m->load == 1) fly(m);
    m->step++;
    m->time += STEP_S;
    if (m->load == 0 && m->opened_at >= 0 && m->time >= m->opened_at + m->delay) let_go(m);
    sense(m, m->step);
}

/* --- interface ----------------------------------------------------------------------------------- */
Machine *ring_new(int count) { return calloc((size_t)count, sizeof(Machine)); }
void ring_free(Machine *machines) { free(machines); }
int ring_parameters_size(void) { return (int)(sizeof(Parameters) / sizeof(double)); }
int ring_output_size(void) { return (int)(sizeof(Output) / sizeof(double)); }

void ring_configure(Machine *machines, int i, const double *parameters) {
    Machine *m = machines + i;
    memcpy(&m->p, parameters, sizeof(Parameters));
    double mass[JOINTS][JOINTS], bias[JOINTS], still[JOINTS] = {0}, pose[JOINTS] = {0, 0.5, 0.0, 0.4, -0.5, 0};
    mass_and_bias(m, pose, still, mass, bias);
    for (int j = 0; j < DRIVEN; j++) {
        double w = 2.0 * PI * m->p.oil_frequency[j];
        m->stiffness[j] = w * w * mass[j][j];
        m->damping[j] = 2.0 * m->p.oil_damping[j] * w * mass[j][j];
    }
    double a[9], b[9], c[9], up[3] = {0, 0, -9.81};
    rotation(2, m->p.base_turn[2], a);
    rotation(1, m->p.base_turn[1], b);
    multiply(a, b, c);
    rotation(0, m->p.base_turn[0], a);
    multiply(c, a, m->turn);
    turn_back(m->turn, up, m->gravity);
}

/* At rest where the sensors report `reported`; the gripper hangs as gravity has it, by as much as asked off plumb. */
void ring_reset(Machine *machines, int i, const double *reported, uint64_t seed, double time) {
    Machine *m = machines + i;
    double mass[JOINTS][JOINTS], bias[JOINTS], up[3], r[9];
    m->rng = seed * 0x2545F4914F6CDD1Dull + 88172645463325252ull + (uint64_t)i;
    for (int k = 0; k < 8; k++) uniform(m);
    memset(m->x, 0, sizeof m->x);
    for (int j = 0; j < DRIVEN; j++) m->x[Q + j] = reported[j] - m->p.joint_bias[j];
    rotation(2, m->x[Q], r);
    turn_back(r, m->gravity, up);
    for (int k = 0; k < 3; k++) up[k] /= -9.81;
    double plumb = -m->x[Q + 1] - m->x[Q + 2] + atan2(-up[0], up[2]);
    m->x[Q + 4] = plumb + reported[4] + reported[1] + reported[2];
    m->x[Q + 5] = -asin(clamp(up[1], -1.0, 1.0)) + reported[5];
    m->hold_angle[0] = m->x[Q + 4];
    m->hold_angle[1] = m->x[Q + 5];
    m->time = time;
    m->load = 0;
    m->is_open = m->collided = 0;
    m->opened_at = m->released_at = m->landed_at = -1.0;
    m->impact_time = 0.0;
    m->ball_count = m->sample_count = m->imu_count = 0;
    m->step = 0;
    m->frozen = 0;
    memset(m->command, 0, sizeof m->command);
    memset(m->played, 0, sizeof m->played);
    memset(m->spool_target, 0, sizeof m->spool_target);
    memset(m->delayed, 0, sizeof m->delayed);
    memset(m->was_moved, 0, sizeof m->was_moved);
    memset(m->stuck_until, 0, sizeof m->stuck_until);
    m->delay = fmax(m->p.release_delay + m->p.release_sd * normal(m), 0.01);
    double share = 0.0;
    for (int j = 0; j < DRIVEN; j++) {
        share = fmax(share, m->p.stick_share[j]);
        m->throw_gain[j] = 1.0 + m->p.noise * 0.002 * normal(m);
    }
    m->sticks = uniform(m) < share;
    double still[JOINTS] = {0};
    mass_and_bias(m, m->x + Q, still, mass, bias);
    for (int j = 0; j < DRIVEN; j++) {
        m->x[DEFLECTION + j] = bias[j] / (m->stiffness[j] * (1.0 - m->p.air_in_oil[j]));
        m->filtered[j] = m->x[Q + j];
        m->quantised[j] = m->p.quantum[j] * floor((m->x[Q + j] + m->p.joint_bias[j]) / m->p.quantum[j] + 0.5);
        m->speed[j] = 0.0;
    }
    m->x[PUMP] = m->p.pump_margin;
    m->x[ENGINE] = 1.0;
    Chain c;
    chain_motion(m, m->x + Q, still, still, &c);
    for (int k = 0; k < 3; k++) m->imu_filtered[k] = 0.0;
    double upward[3] = {-m->gravity[0], -m->gravity[1], -m->gravity[2]};
    turn_back(c.r[5], upward, m->imu_filtered + 3);
    for (int k = -SAMPLES * 20 + 40; k <= 0; k += 10) { /* history of a machine at rest, for late sensors */
        m->time = time + k * STEP_S;
        sense(m, (k % 20 == 0) ? 20 : 10);
    }
    m->time = time;
    check_collision(m);
}

void ring_reload(Machine *machines, int i) {
    Machine *m = machines + i;
    if (m->load == 0) return;
    m->load = 0;
    m->opened_at = -1.0;
    m->impact_time = 0.0;
    m->delay = fmax(m->p.release_delay + m->p.release_sd * normal(m), 0.01);
}

void ring_set(Machine *machines, int i, double surface, int frozen) {
    machines[i].surface = surface;
    machines[i].frozen = frozen;
}

void ring_advance(Machine *machines, int count, const double *valves, const uint8_t *open, double start, int ticks) {
    for (int i = 0; i < count; i++) {
        Machine *m = machines + i;
        m->time = start;
        if (m->frozen) {
            m->time += ticks * STEPS_A_TICK * STEP_S;
            continue;
        }
        for (int j = 0; j < DRIVEN; j++) m->command[j] = clamp(valves[4 * i + j], -1.0, 1.0);
        if (open[i] && m->opened_at < 0) m->opened_at = m->time;
        for (int t = 0; t < ticks; t++) {
            for (int s = 0; s < STEPS_A_TICK; s++) one_step(m);
            check_collision(m);
        }
    }
}

void ring_read(Machine *machines, int count, double *outputs) {
    for (int i = 0; i < count; i++) {
        Machine *m = machines + i;
        Output o;
        memset(&o, 0, sizeof o);
        const JointSample *newest = &m->joints[(m->sample_count - 1) % SAMPLES];
        o.joint_time = newest->time - 0.006; /* the filter's known delay */
        for (int j = 0; j < DRIVEN; j++) {
            long late = (long)(m->p.joint_latency[j] / 0.005 + 0.5);
            const JointSample *s = &m->joints[(m->sample_count - 1 - late) % SAMPLES];
            o.position[j] = s->position[j];
            o.velocity[j] = s->velocity[j];
        }
        long imu_late = 6, extra = (long)(m->p.imu_latency / 0.010 + 0.5); /* radio: 60 ms */
        const ImuSample *stamp = &m->imu[(m->imu_count - 1 - imu_late) % SAMPLES];
        const ImuSample *imu = &m->imu[(m->imu_count - 1 - imu_late - extra) % SAMPLES];
        o.imu_time = stamp->time - 0.008;
        memcpy(o.gyro, imu->gyro, sizeof o.gyro);
        memcpy(o.accel, imu->accel, sizeof o.accel);
        o.held = m->load == 0 || (m->load == 1 && m->time < m->released_at + 0.025);
        o.pressure = m->x[PUMP];
        if (m->load == 1 && m->ball_count > 2) {
            const double *b = m->ball_samples[(m->ball_count - 2) % 8]; /* 20 to 40 ms late */
            o.ball_time = b[0];
            memcpy(o.ball, b + 1, sizeof o.ball);
        }
        if (m->load == 2 && m->time > m->impact_time + 0.2) {
            o.impact_time = m->impact_time;
            memcpy(o.impact, m->impact, sizeof o.impact);
        }
        o.collided = m->collided;
        memcpy(o.true_position, m->x + Q, sizeof o.true_position);
        memcpy(outputs + i * (sizeof o / sizeof(double)), &o, sizeof o);
    }
}

/* For tests: mass matrix (6, 6) and bias forces (6) at the present state. */
void ring_mass(Machine *machines, int i, double *mass_out, double *bias_out) {
    double mass[JOINTS][JOINTS], bias[JOINTS];
    mass_and_bias(machines + i, machines[i].x + Q, machines[i].x + QD, mass, bias);
    memcpy(mass_out, mass, sizeof mass);
    memcpy(bias_out, bias, sizeof bias);
}
