/* hil_gnc.h: what passes between the bench and a GNC of the user's own. Printed by: hil gnc-header
 *
 * The same bytes are the structs of a shared library and the cells gnc.setup, gnc.input and gnc.output on the wire
 * (docs/your-own-gnc.md). Little-endian; aligned as a compiler for x86-64 or ARM64 does. SI units.
 * Frames: H is Hill's (LVLH) frame of the target, c the chaser's body. Quaternions have the scalar last;
 * q_CH turns components in H into components in c.
 */
#ifndef HIL_GNC_H
#define HIL_GNC_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HIL_GNC_PROTOCOL 1
#define HIL_GNC_REASON_BYTES 128

enum hil_gnc_mode {
    HIL_GNC_STANDBY = 0, /* the setup stands, nothing is measured yet */
    HIL_GNC_ARMED = 1, /* the bench stands at the start pose; time has not begun */
    HIL_GNC_RUNNING = 2, /* time runs; each input wants an output */
    HIL_GNC_HOLD = 3, /* the axes are braked and time stands; inputs say so, the GNC keeps its state */
    HIL_GNC_STOPPED = 4, /* the run is over */
};

enum hil_gnc_order {
    HIL_GNC_GO = 1, /* the operator lets the approach go on from its wait */
    HIL_GNC_ABORT = 2, /* an abort has begun, ordered or by supervision: the reference brakes and retreats from here on */
};

enum hil_gnc_state {
    HIL_GNC_STARTING = 0, /* has not answered a RUNNING input yet; its demands do not count */
    HIL_GNC_WORKING = 1,
    HIL_GNC_ASKS_FOR_HOLD = 2, /* the bench is to be brought to a stand, the run can go on */
    HIL_GNC_FAULT = 3, /* the bench is to stop; text says why */
};

typedef struct {
    char scenario[32]; /* its name */
    double step_s; /* of a cycle */
    double duration_s;
    double mean_motion_radps; /* of the target's orbit: Hill's equations */
    double mass_kg;
    double inertia_kgm2[3][3]; /* in c */
    int64_t n_thrusters;
    double thruster_position_m[24][3]; /* in c */
    double thruster_force_N[24][3]; /* on the chaser while open, in c */
    double minimum_on_s;
    double acceleration_mps2[3]; /* of a force demand along each axis of c, without boost */
    double angular_acceleration_radps2[3]; /* of a torque demand about each axis of c */
    double start_r_CT_H_m[3];
    double start_q_CH[4];
    double ready_point_m[3]; /* in H: where the chaser is to wait for docking */
    double closing_rate_max_mps;
} hil_gnc_setup;

typedef struct {
    double t_s; /* moment of exposure, time of the run */
    double r_TC_C_m[3]; /* target's reference point seen from the chaser's, in c */
    double q_CH[4];
    double covariance_position_m2[3][3]; /* in c */
    double covariance_attitude_rad2[3][3]; /* of the small turn of c, in c */
} hil_gnc_pose;

typedef struct {
    int64_t cycle; /* RUNNING: counts from 0, the output carries the same number; else the last one, at first -1 */
    double t_s; /* time of the run */
    int32_t mode; /* hil_gnc_mode */
    int32_t orders; /* hil_gnc_order */
    double rate_radps[3]; /* gyro, mean over the last step, in c, against inertial space */
    double force_mps2[3]; /* accelerometer, mean over the last step, in c */
    double reference_r_CT_H_m[3]; /* the scenario's own plan at t_s: to be followed, or left alone */
    double reference_v_CT_H_mps[3];
    double reference_a_CT_H_mps2[3];
    double reference_q_CH[4];
    int64_t boost;
    int64_t n_poses; /* that came since the last input */
    hil_gnc_pose poses[4];
} hil_gnc_input;

typedef struct {
    int64_t cycle; /* of the input that this answers */
    int32_t state; /* hil_gnc_state */
    int32_t direct; /* 1: on opens thrusters; 0: force and torque are allocated by the bench */
    int32_t force[3]; /* -1, 0 or 1: demand along each axis of c */
    int32_t torque[3]; /* the same about each axis */
    uint8_t on[24]; /* 0 or 1 a thruster */
    int64_t estimate; /* 1: the fields below hold an estimate, which is recorded and supervised */
    double r_CT_H_m[3];
    double v_CT_H_mps[3];
    double q_CH[4];
    double w_CH_C_radps[3];
    char text[64]; /* a word for the operator; "" for none */
} hil_gnc_output;

/* A shared library has these four functions. All are called from one thread at a time and must not block. */

/* Return HIL_GNC_PROTOCOL. */
int hil_gnc_protocol(void);

/* Return a GNC that knows *setup, or NULL to refuse it, with the reason as a text of up to HIL_GNC_REASON_BYTES
 * bytes, its closing zero included. There may be several at a time: keep nothing in global variables. */
void *hil_gnc_open(const hil_gnc_setup *setup, char *reason);

/* Answer *input in *output, which comes with the input's cycle, as HIL_GNC_WORKING, and with zeros in all else.
 * The bench calls it in each cycle in which the run's time runs (HIL_GNC_RUNNING) or is held (HIL_GNC_HOLD).
 * Return 0; anything else is a fault that stops the bench. */
int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output);

/* Free what hil_gnc_open returned. */
void hil_gnc_close(void *gnc);

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
_Static_assert(sizeof(hil_gnc_setup) == 1440, "size of hil_gnc_setup");
_Static_assert(offsetof(hil_gnc_setup, scenario) == 0, "place of hil_gnc_setup.scenario");
_Static_assert(offsetof(hil_gnc_setup, step_s) == 32, "place of hil_gnc_setup.step_s");
_Static_assert(offsetof(hil_gnc_setup, duration_s) == 40, "place of hil_gnc_setup.duration_s");
_Static_assert(offsetof(hil_gnc_setup, mean_motion_radps) == 48, "place of hil_gnc_setup.mean_motion_radps");
_Static_assert(offsetof(hil_gnc_setup, mass_kg) == 56, "place of hil_gnc_setup.mass_kg");
_Static_assert(offsetof(hil_gnc_setup, inertia_kgm2) == 64, "place of hil_gnc_setup.inertia_kgm2");
_Static_assert(offsetof(hil_gnc_setup, n_thrusters) == 136, "place of hil_gnc_setup.n_thrusters");
_Static_assert(offsetof(hil_gnc_setup, thruster_position_m) == 144, "place of hil_gnc_setup.thruster_position_m");
_Static_assert(offsetof(hil_gnc_setup, thruster_force_N) == 720, "place of hil_gnc_setup.thruster_force_N");
_Static_assert(offsetof(hil_gnc_setup, minimum_on_s) == 1296, "place of hil_gnc_setup.minimum_on_s");
_Static_assert(offsetof(hil_gnc_setup, acceleration_mps2) == 1304, "place of hil_gnc_setup.acceleration_mps2");
_Static_assert(offsetof(hil_gnc_setup, angular_acceleration_radps2) == 1328, "place of hil_gnc_setup.angular_acceleration_radps2");
_Static_assert(offsetof(hil_gnc_setup, start_r_CT_H_m) == 1352, "place of hil_gnc_setup.start_r_CT_H_m");
_Static_assert(offsetof(hil_gnc_setup, start_q_CH) == 1376, "place of hil_gnc_setup.start_q_CH");
_Static_assert(offsetof(hil_gnc_setup, ready_point_m) == 1408, "place of hil_gnc_setup.ready_point_m");
_Static_assert(offsetof(hil_gnc_setup, closing_rate_max_mps) == 1432, "place of hil_gnc_setup.closing_rate_max_mps");
_Static_assert(sizeof(hil_gnc_pose) == 208, "size of hil_gnc_pose");
_Static_assert(offsetof(hil_gnc_pose, t_s) == 0, "place of hil_gnc_pose.t_s");
_Static_assert(offsetof(hil_gnc_pose, r_TC_C_m) == 8, "place of hil_gnc_pose.r_TC_C_m");
_Static_assert(offsetof(hil_gnc_pose, q_CH) == 32, "place of hil_gnc_pose.q_CH");
_Static_assert(offsetof(hil_gnc_pose, covariance_position_m2) == 64, "place of hil_gnc_pose.covariance_position_m2");
_Static_assert(offsetof(hil_gnc_pose, covariance_attitude_rad2) == 136, "place of hil_gnc_pose.covariance_attitude_rad2");
_Static_assert(sizeof(hil_gnc_input) == 1024, "size of hil_gnc_input");
_Static_assert(offsetof(hil_gnc_input, cycle) == 0, "place of hil_gnc_input.cycle");
_Static_assert(offsetof(hil_gnc_input, t_s) == 8, "place of hil_gnc_input.t_s");
_Static_assert(offsetof(hil_gnc_input, mode) == 16, "place of hil_gnc_input.mode");
_Static_assert(offsetof(hil_gnc_input, orders) == 20, "place of hil_gnc_input.orders");
_Static_assert(offsetof(hil_gnc_input, rate_radps) == 24, "place of hil_gnc_input.rate_radps");
_Static_assert(offsetof(hil_gnc_input, force_mps2) == 48, "place of hil_gnc_input.force_mps2");
_Static_assert(offsetof(hil_gnc_input, reference_r_CT_H_m) == 72, "place of hil_gnc_input.reference_r_CT_H_m");
_Static_assert(offsetof(hil_gnc_input, reference_v_CT_H_mps) == 96, "place of hil_gnc_input.reference_v_CT_H_mps");
_Static_assert(offsetof(hil_gnc_input, reference_a_CT_H_mps2) == 120, "place of hil_gnc_input.reference_a_CT_H_mps2");
_Static_assert(offsetof(hil_gnc_input, reference_q_CH) == 144, "place of hil_gnc_input.reference_q_CH");
_Static_assert(offsetof(hil_gnc_input, boost) == 176, "place of hil_gnc_input.boost");
_Static_assert(offsetof(hil_gnc_input, n_poses) == 184, "place of hil_gnc_input.n_poses");
_Static_assert(offsetof(hil_gnc_input, poses) == 192, "place of hil_gnc_input.poses");
_Static_assert(sizeof(hil_gnc_output) == 240, "size of hil_gnc_output");
_Static_assert(offsetof(hil_gnc_output, cycle) == 0, "place of hil_gnc_output.cycle");
_Static_assert(offsetof(hil_gnc_output, state) == 8, "place of hil_gnc_output.state");
_Static_assert(offsetof(hil_gnc_output, direct) == 12, "place of hil_gnc_output.direct");
_Static_assert(offsetof(hil_gnc_output, force) == 16, "place of hil_gnc_output.force");
_Static_assert(offsetof(hil_gnc_output, torque) == 28, "place of hil_gnc_output.torque");
_Static_assert(offsetof(hil_gnc_output, on) == 40, "place of hil_gnc_output.on");
_Static_assert(offsetof(hil_gnc_output, estimate) == 64, "place of hil_gnc_output.estimate");
_Static_assert(offsetof(hil_gnc_output, r_CT_H_m) == 72, "place of hil_gnc_output.r_CT_H_m");
_Static_assert(offsetof(hil_gnc_output, v_CT_H_mps) == 96, "place of hil_gnc_output.v_CT_H_mps");
_Static_assert(offsetof(hil_gnc_output, q_CH) == 120, "place of hil_gnc_output.q_CH");
_Static_assert(offsetof(hil_gnc_output, w_CH_C_radps) == 152, "place of hil_gnc_output.w_CH_C_radps");
_Static_assert(offsetof(hil_gnc_output, text) == 176, "place of hil_gnc_output.text");
#endif

#ifdef __cplusplus
}
#endif
#endif
