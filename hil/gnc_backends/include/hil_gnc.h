/* hil_gnc.h: records exchanged between the bench and an external GNC. Printed by: hil gnc header
 *
 * The same bytes are the structs of a shared library and the mailboxes gnc.setup, gnc.input and gnc.output on the wire
 * (docs/how-to/connect-your-gnc.md), where the last fields of the setup are the mailbox gnc.orbit, and the input ends
 * before `measured`, whose parts are the mailboxes imu.samples, gnc.poses and gnc.measurements. Little-endian; aligned
 * as a compiler for x86-64 or ARM64 does. SI units.
 * Frames: H is Hill's (LVLH) frame of the target, c the chaser's body. Quaternions have the scalar last;
 * q_CH takes components in H to components in c.
 */
#ifndef HIL_GNC_H
#define HIL_GNC_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HIL_GNC_PROTOCOL 4
#define HIL_GNC_REASON_BYTES 128

enum hil_gnc_mode {
    HIL_GNC_STANDBY = 0, /* the setup is complete, nothing is measured yet */
    HIL_GNC_ARMED = 1, /* the bench is at the start pose; the run's time has not started */
    HIL_GNC_RUNNING = 2, /* the run's time advances; each input requires an output */
    HIL_GNC_HOLD = 3, /* the axes are braked and the run's time is held; the GNC keeps its state */
    HIL_GNC_STOPPED = 4, /* the run is over */
};

enum hil_gnc_order {
    HIL_GNC_GO = 1, /* the operator releases the approach from its wait */
    HIL_GNC_ABORT = 2, /* an abort has started, by command or by the approach monitor: the reference brakes and retreats */
};

enum hil_gnc_state {
    HIL_GNC_STARTING = 0, /* no RUNNING input has been answered yet; demands are ignored */
    HIL_GNC_WORKING = 1,
    HIL_GNC_ASKS_FOR_HOLD = 2, /* requests a hold; the run can be resumed */
    HIL_GNC_FAULT = 3, /* requests a stop of the bench; text gives the reason */
};

enum hil_gnc_health {
    HIL_GNC_VISION_LOST = 1, /* no pose of the vision unit is usable */
    HIL_GNC_VISION_SUSPECT = 2, /* poses are rejected, or their innovations are not those of their covariance */
    HIL_GNC_IMU_SUSPECT = 4,
    HIL_GNC_THRUSTER_FAULT = 8, /* a thruster does not do what is commanded */
    HIL_GNC_MONITOR_DISAGREES = 16, /* the docking monitor measures another pose */
    HIL_GNC_COVARIANCE_INVALID = 32, /* a covariance of the filters is not finite or not positive definite */
    HIL_GNC_BENCH_DISAGREES = 64, /* the bench's encoders contradict the estimate */
    HIL_GNC_SENSOR_SUSPECT = 128, /* a further sensor contradicts the others and is excluded */
    HIL_GNC_CAUSE_UNKNOWN = 256, /* innovations or the IMU are inconsistent, and no device stands out as the cause */
};

typedef struct {
    char scenario[32]; /* name of the scenario */
    double step_s; /* length of a cycle; s */
    double duration_s; /* length of the run; s */
    double mean_motion_radps; /* of the target's orbit: Hill's equations; rad/s */
    double mass_kg; /* nominal mass of the chaser; kg */
    double inertia_kgm2[3][3]; /* nominal inertia of the chaser; kg m^2, in c */
    int64_t n_thrusters; /* number of thrusters; the other places are zero */
    double thruster_position_m[24][3]; /* position of each thruster; m, in c */
    double thruster_force_N[24][3]; /* force on the chaser while open; N, in c */
    double minimum_on_s; /* shortest burn; s */
    double acceleration_mps2[3]; /* of a force demand along each axis, without boost; m/s^2, in c */
    double angular_acceleration_radps2[3]; /* of a torque demand about each axis; rad/s^2, in c */
    double start_r_CT_H_m[3]; /* position at the start; m, in H */
    double start_q_CH[4]; /* attitude at the start; H to c */
    double ready_point_m[3]; /* where the chaser waits for docking; m, in H */
    double closing_rate_max_mps; /* largest closing rate; m/s */
    double eccentricity; /* of the target's orbit, 0 for a circle */
    double mean_anomaly_rad; /* of the target at t_s = 0; rad */
    int64_t tumbles; /* 1: H is fixed in the body of a target that rotates freely; 0: Hill's frame */
    double target_rate_radps[3]; /* of that body against inertial space at t_s = 0; else zero; rad/s, in H */
    double target_inertia_kgm2[3][3]; /* inertia of that body; else zero; kg m^2, in H */
} hil_gnc_setup;

typedef struct {
    double t_s; /* moment of exposure, time of the run; s */
    double r_TC_C_m[3]; /* target's reference point seen from the chaser's; m, in c */
    double q_CH[4]; /* measured attitude; H to c */
    double covariance_position_m2[3][3]; /* covariance of r_TC_C_m; m^2, in c */
    double covariance_attitude_rad2[3][3]; /* covariance of the small-angle rotation of c; rad^2, in c */
} hil_gnc_pose;

typedef struct {
    double rate_radps[3]; /* gyro, mean over the sample, against inertial space; rad/s, in c */
    double force_mps2[3]; /* accelerometer, mean over the sample; m/s^2, in c */
} hil_backend_sample;

typedef struct {
    double t_s; /* moment of exposure, time of the run; s */
    double r_TC_C_m[3]; /* target's reference point seen from the chaser's; m, in c */
    double q_CH[4]; /* measured attitude; H to c */
    double covariance_position_m2[3][3]; /* covariance of r_TC_C_m; m^2, in c */
    double covariance_attitude_rad2[3][3]; /* covariance of the small-angle rotation of c; rad^2, in c */
    double covariance_cross_m_rad[3][3]; /* of r_TC_C_m (rows) and the small-angle rotation; m rad, in c */
    int64_t status; /* status that the vision unit reported with the pose: 0 good, 2 a position whose attitude is a guess */
} hil_backend_pose;

typedef struct {
    int64_t sensor; /* number of the sensor in the scenario, from 0 */
    int64_t number; /* number of the measurement of that sensor, from 0 */
    double t_s; /* moment of the measurement, time of the run; s */
    double received_s; /* when the loop received it, time of the run; s */
    double value[6]; /* components as the module declares them; the others are zero; SI */
    double covariance[6][6]; /* of the noise, as the sensor reports it; zero if it does not; SI */
    int64_t status; /* status that the sensor reported, 0 good */
} hil_measurement;

typedef struct {
    int64_t n_samples; /* samples of the IMU since the cycle before; none in cycle 0 */
    int64_t n_poses; /* poses since the cycle before */
    int64_t n_measurements; /* measurements of further sensors since the cycle before */
    hil_backend_sample samples[64]; /* the first n_samples are valid */
    hil_backend_pose poses[4]; /* the first n_poses are valid, in order of arrival */
    hil_measurement measurements[16]; /* the first n_measurements are valid */
} hil_measured;

typedef struct {
    int64_t cycle; /* RUNNING: counts from 0, the output has the same number; else the last one, initially -1 */
    double t_s; /* time of the run; s */
    int32_t mode; /* hil_gnc_mode */
    int32_t orders; /* hil_gnc_order */
    double rate_radps[3]; /* gyro, mean over the last step, against inertial space; rad/s, in c */
    double force_mps2[3]; /* accelerometer, mean over the last step; m/s^2, in c */
    double reference_r_CT_H_m[3]; /* the scenario's plan at t_s; its use is optional; m, in H */
    double reference_v_CT_H_mps[3]; /* velocity of the plan; m/s, in H */
    double reference_a_CT_H_mps2[3]; /* acceleration of the plan; m/s^2, in H */
    double reference_q_CH[4]; /* attitude of the plan; H to c */
    int64_t boost; /* 1: force demands open the high-thrust sets, as the brake of an abort needs */
    int64_t n_poses; /* number of poses since the last input */
    hil_gnc_pose poses[4]; /* the first n_poses are valid; whole poses alone */
    hil_measured measured; /* all samples, poses and measurements, as a navigation receives them */
} hil_gnc_input;

typedef struct {
    int64_t cycle; /* of the input that this answers */
    int32_t state; /* hil_gnc_state */
    int32_t direct; /* 1: on opens thrusters; 0: the bench allocates force and torque */
    int32_t force[3]; /* demand along each axis: -1, 0 or 1; in c */
    int32_t torque[3]; /* demand about each axis: -1, 0 or 1; in c */
    uint8_t on[24]; /* thrusters, 0 or 1 */
    int64_t estimate; /* 1: the next four fields hold an estimate, which is recorded and monitored */
    double r_CT_H_m[3]; /* estimated position; m, in H */
    double v_CT_H_mps[3]; /* estimated velocity; m/s, in H */
    double q_CH[4]; /* estimated attitude; H to c */
    double w_CH_C_radps[3]; /* estimated rate against H; rad/s, in c */
    char text[64]; /* message for the operator; empty for none */
    double protection_level_m[3]; /* bound on the error of r_CT_H_m, per axis; 0 or nan: not reported; m, in H */
    double protection_level_rad; /* bound on the attitude error; 0 or nan: not reported; rad */
    int64_t health; /* 0 healthy; sum of hil_gnc_health */
} hil_gnc_output;

/* A shared library has these four functions. They are called from one thread at a time and must not block. */

/* Return HIL_GNC_PROTOCOL. The bench accepts 3 to 4: fields are appended, never moved. */
int hil_gnc_protocol(void);

/* Return a GNC for *setup, or NULL to reject it with the reason as text of up to HIL_GNC_REASON_BYTES bytes,
 * including its terminating zero. Several can exist at a time: keep nothing in global variables. */
void *hil_gnc_open(const hil_gnc_setup *setup, char *reason);

/* Answer *input in *output, which is preset to the input's cycle, HIL_GNC_WORKING and zeros.
 * The bench calls it in each cycle while the run's time advances (HIL_GNC_RUNNING) or is held (HIL_GNC_HOLD).
 * Return 0; any other value is a fault that stops the bench. */
int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output);

/* Free the GNC that hil_gnc_open returned. */
void hil_gnc_close(void *gnc);

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
_Static_assert(sizeof(hil_gnc_setup) == 1560, "size of hil_gnc_setup");
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
_Static_assert(offsetof(hil_gnc_setup, eccentricity) == 1440, "place of hil_gnc_setup.eccentricity");
_Static_assert(offsetof(hil_gnc_setup, mean_anomaly_rad) == 1448, "place of hil_gnc_setup.mean_anomaly_rad");
_Static_assert(offsetof(hil_gnc_setup, tumbles) == 1456, "place of hil_gnc_setup.tumbles");
_Static_assert(offsetof(hil_gnc_setup, target_rate_radps) == 1464, "place of hil_gnc_setup.target_rate_radps");
_Static_assert(offsetof(hil_gnc_setup, target_inertia_kgm2) == 1488, "place of hil_gnc_setup.target_inertia_kgm2");
_Static_assert(sizeof(hil_gnc_pose) == 208, "size of hil_gnc_pose");
_Static_assert(offsetof(hil_gnc_pose, t_s) == 0, "place of hil_gnc_pose.t_s");
_Static_assert(offsetof(hil_gnc_pose, r_TC_C_m) == 8, "place of hil_gnc_pose.r_TC_C_m");
_Static_assert(offsetof(hil_gnc_pose, q_CH) == 32, "place of hil_gnc_pose.q_CH");
_Static_assert(offsetof(hil_gnc_pose, covariance_position_m2) == 64, "place of hil_gnc_pose.covariance_position_m2");
_Static_assert(offsetof(hil_gnc_pose, covariance_attitude_rad2) == 136, "place of hil_gnc_pose.covariance_attitude_rad2");
_Static_assert(sizeof(hil_backend_sample) == 48, "size of hil_backend_sample");
_Static_assert(offsetof(hil_backend_sample, rate_radps) == 0, "place of hil_backend_sample.rate_radps");
_Static_assert(offsetof(hil_backend_sample, force_mps2) == 24, "place of hil_backend_sample.force_mps2");
_Static_assert(sizeof(hil_backend_pose) == 288, "size of hil_backend_pose");
_Static_assert(offsetof(hil_backend_pose, t_s) == 0, "place of hil_backend_pose.t_s");
_Static_assert(offsetof(hil_backend_pose, r_TC_C_m) == 8, "place of hil_backend_pose.r_TC_C_m");
_Static_assert(offsetof(hil_backend_pose, q_CH) == 32, "place of hil_backend_pose.q_CH");
_Static_assert(offsetof(hil_backend_pose, covariance_position_m2) == 64, "place of hil_backend_pose.covariance_position_m2");
_Static_assert(offsetof(hil_backend_pose, covariance_attitude_rad2) == 136, "place of hil_backend_pose.covariance_attitude_rad2");
_Static_assert(offsetof(hil_backend_pose, covariance_cross_m_rad) == 208, "place of hil_backend_pose.covariance_cross_m_rad");
_Static_assert(offsetof(hil_backend_pose, status) == 280, "place of hil_backend_pose.status");
_Static_assert(sizeof(hil_measurement) == 376, "size of hil_measurement");
_Static_assert(offsetof(hil_measurement, sensor) == 0, "place of hil_measurement.sensor");
_Static_assert(offsetof(hil_measurement, number) == 8, "place of hil_measurement.number");
_Static_assert(offsetof(hil_measurement, t_s) == 16, "place of hil_measurement.t_s");
_Static_assert(offsetof(hil_measurement, received_s) == 24, "place of hil_measurement.received_s");
_Static_assert(offsetof(hil_measurement, value) == 32, "place of hil_measurement.value");
_Static_assert(offsetof(hil_measurement, covariance) == 80, "place of hil_measurement.covariance");
_Static_assert(offsetof(hil_measurement, status) == 368, "place of hil_measurement.status");
_Static_assert(sizeof(hil_measured) == 10264, "size of hil_measured");
_Static_assert(offsetof(hil_measured, n_samples) == 0, "place of hil_measured.n_samples");
_Static_assert(offsetof(hil_measured, n_poses) == 8, "place of hil_measured.n_poses");
_Static_assert(offsetof(hil_measured, n_measurements) == 16, "place of hil_measured.n_measurements");
_Static_assert(offsetof(hil_measured, samples) == 24, "place of hil_measured.samples");
_Static_assert(offsetof(hil_measured, poses) == 3096, "place of hil_measured.poses");
_Static_assert(offsetof(hil_measured, measurements) == 4248, "place of hil_measured.measurements");
_Static_assert(sizeof(hil_gnc_input) == 11288, "size of hil_gnc_input");
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
_Static_assert(offsetof(hil_gnc_input, measured) == 1024, "place of hil_gnc_input.measured");
_Static_assert(sizeof(hil_gnc_output) == 280, "size of hil_gnc_output");
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
_Static_assert(offsetof(hil_gnc_output, protection_level_m) == 240, "place of hil_gnc_output.protection_level_m");
_Static_assert(offsetof(hil_gnc_output, protection_level_rad) == 264, "place of hil_gnc_output.protection_level_rad");
_Static_assert(offsetof(hil_gnc_output, health) == 272, "place of hil_gnc_output.health");
#endif

#ifdef __cplusplus
}
#endif
#endif
