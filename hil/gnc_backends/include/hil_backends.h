/* hil_backends.h: records of backends of navigation and of control. Printed by: hil gnc header --backends
 *
 * A backend takes the place of the built-in navigation or the built-in control (docs/how-to/fly-a-law.md).
 * Enumerations, setup and what is measured are those of hil_gnc.h. SI units. Frames: H is Hill's (LVLH) frame of the
 * target, c the chaser's body. Quaternions have the scalar last; q_CH takes components in H to components in c.
 */
#ifndef HIL_BACKENDS_H
#define HIL_BACKENDS_H

#include "hil_gnc.h"

#ifdef __cplusplus
extern "C" {
#endif

#define HIL_BACKENDS_PROTOCOL 2

typedef struct {
    int64_t valid; /* 1 after the first pose */
    double r_CT_H[3]; /* estimated position; m, in H */
    double v_CT_H[3]; /* estimated velocity; m/s, in H */
    double q_CH[4]; /* estimated attitude, scalar last; H to c */
    double w_CH_C[3]; /* estimated rate of the chaser against H; rad/s, in c */
    double sigma_r_m[3]; /* standard deviation of the position; m, in H */
    double sigma_v_mps[3]; /* standard deviation of the velocity; m/s, in H */
    double sigma_attitude_rad[3]; /* standard deviation of the attitude; rad, in c */
    double nis_position; /* normalised innovation squared, 3 components; nan without an update */
    double nis_attitude; /* normalised innovation squared, 3 components; nan without an update */
    double protection_level_m[3]; /* bound on the position error, nan if not reported; m, in H */
    double protection_level_rad; /* bound on the attitude error, nan if not reported; rad */
    int64_t health; /* 0 healthy; sum of the bits of hil_gnc_health */
} hil_navigation;

typedef struct {
    double r_CT_H[3]; /* reference position; m, in H */
    double v_CT_H[3]; /* reference velocity; m/s, in H */
    double a_CT_H[3]; /* reference acceleration; m/s^2, in H */
    double q_CH[4]; /* reference attitude, scalar last; H to c */
    int64_t boost; /* 1: force demands open the high-thrust sets */
    int64_t phase; /* number of the phase; after the list: brake, retreat, hold of an abort */
    double from_H[3]; /* start of the phase's line; m, in H */
    double to_H[3]; /* end of the phase's line; m, in H */
} hil_reference;

typedef struct {
    int64_t cycle; /* number of the cycle, from 0 */
    double t_s; /* time of the run; s */
    int32_t mode; /* hil_gnc_mode; a backend is called in RUNNING only */
    int32_t orders; /* hil_gnc_order, as of the cycle before */
    int64_t imu_suspect; /* 1: the IMU's readings repeat, or no thruster explains them */
    int64_t n_samples; /* samples of the IMU since the cycle before; none in cycle 0 */
    int64_t n_poses; /* poses since the cycle before */
    double second_bound_m; /* bound on the position error by the docking monitor; 0: none; m */
    double second_bound_s; /* time of its measurement, time of the run; s */
    int64_t fault; /* of a thruster, by the thruster monitor: 0 none, 1 stuck open, 2 dead */
    int64_t fault_thruster; /* that has it, from 0 */
    uint8_t commanded[24]; /* thrusters commanded in the cycle before, 0 or 1 */
    uint8_t isolated[24]; /* thrusters whose supply is being or has been closed, 0 or 1 */
    hil_backend_sample samples[64]; /* the first n_samples are valid */
    hil_backend_pose poses[4]; /* the first n_poses are valid, in order of arrival */
    hil_gnc_setup setup; /* nominal vehicle and plan: hil_gnc_setup */
    int64_t n_measurements; /* measurements of further sensors since the cycle before */
    hil_measurement measurements[16]; /* the first n_measurements are valid */
} hil_navigation_input;

typedef struct {
    int32_t state; /* hil_gnc_state */
    int64_t valid; /* 1 after the first pose */
    double r_CT_H[3]; /* estimated position; m, in H */
    double v_CT_H[3]; /* estimated velocity; m/s, in H */
    double q_CH[4]; /* estimated attitude, scalar last; H to c */
    double w_CH_C[3]; /* estimated rate of the chaser against H; rad/s, in c */
    double sigma_r_m[3]; /* standard deviation of the position; m, in H */
    double sigma_v_mps[3]; /* standard deviation of the velocity; m/s, in H */
    double sigma_attitude_rad[3]; /* standard deviation of the attitude; rad, in c */
    double nis_position; /* normalised innovation squared, 3 components; nan without an update */
    double nis_attitude; /* normalised innovation squared, 3 components; nan without an update */
    double protection_level_m[3]; /* bound on the position error, nan if not reported; m, in H */
    double protection_level_rad; /* bound on the attitude error, nan if not reported; rad */
    int64_t health; /* 0 healthy; sum of the bits of hil_gnc_health */
    double bias_mps2[3]; /* estimated bias of the accelerometer; nan: not reported; m/s^2, in c */
    double bias_sigma_mps2[3]; /* its standard deviation; nan: not reported; m/s^2, in c */
    char text[64]; /* message for the operator; empty for none */
} hil_navigation_output;

typedef struct {
    int64_t cycle; /* number of the cycle, from 0 */
    double t_s; /* time of the run; s */
    int32_t mode; /* hil_gnc_mode; a backend is called in RUNNING only */
    int32_t orders; /* hil_gnc_order, as of this cycle */
    int64_t phase; /* number of the phase; after the list: brake, retreat, hold of an abort */
    int64_t reaction; /* to the health: 0 continue, 1 coast, 2 hold, 3 retreat, 4 abort */
    int64_t aborted; /* cause of the abort, 0 for none */
    int64_t fault; /* of a thruster, by the thruster monitor: 0 none, 1 stuck open, 2 dead */
    int64_t fault_thruster; /* that has it, from 0 */
    uint8_t isolated[24]; /* thrusters whose supply is being or has been closed, 0 or 1 */
    uint8_t withheld[24]; /* thrusters that the bench keeps closed in this cycle, 0 or 1 */
    hil_navigation navigation; /* estimate of this cycle; it is valid */
    hil_reference reference; /* reference of this cycle */
    double feed_force_mps2[3]; /* to be fed forward beyond the reference's acceleration; m/s^2, in H */
    double feed_torque_radps2[3]; /* angular acceleration to be fed forward; rad/s^2, in c */
    double reference_rate_radps[3]; /* rate of the reference against H; rad/s, in c */
    hil_gnc_setup setup; /* nominal vehicle and plan: hil_gnc_setup */
} hil_control_input;

typedef struct {
    int32_t state; /* hil_gnc_state */
    int32_t direct; /* 1: on opens thrusters; 0: the bench allocates force and torque */
    int32_t force[3]; /* demand along each axis: -1, 0 or 1; in c */
    int32_t torque[3]; /* demand about each axis: -1, 0 or 1; in c */
    uint8_t on[24]; /* thrusters, 0 or 1 */
    char text[64]; /* message for the operator; empty for none */
} hil_control_output;

/* A setting that a backend declares: a key of the scenario, gnc.control.settings.NAME. low < high: its range. */
typedef struct {
    const char *name;
    const char *unit;
    const char *meaning;
    double value; /* unless the scenario sets another */
    double low;
    double high;
} hil_backend_setting;

/* A shared library has the first function, and those of navigation or of control, or all. They are called from one
 * thread at a time per instance and must not block. */

/* Return HIL_BACKENDS_PROTOCOL. */
int hil_backends_protocol(void);

/* Optional: the declared settings, at most 32; the last one has the name NULL. */
extern const hil_backend_setting hil_navigation_settings[];
extern const hil_backend_setting hil_control_settings[];

/* Return an instance for *setup, or NULL to reject it with the reason as text of up to HIL_GNC_REASON_BYTES bytes,
 * including its terminating zero. settings: the values in the order of their declaration; they may change between two
 * steps, and stay valid until the instance is closed. Several can exist at a time: keep nothing in global variables. */
void *hil_navigation_open(const hil_gnc_setup *setup, const double *settings, char *reason);
void *hil_control_open(const hil_gnc_setup *setup, const double *settings, char *reason);

/* Answer *input in *output, which is preset: no estimate, numbers that are not reported nan; no demands.
 * Return 0; any other value is a fault that stops the bench. */
int hil_navigation_step(const hil_navigation_input *input, hil_navigation_output *output, void *instance);
int hil_control_step(const hil_control_input *input, hil_control_output *output, void *instance);

/* Free the instance. */
void hil_navigation_close(void *instance);
void hil_control_close(void *instance);

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
_Static_assert(sizeof(hil_navigation) == 240, "size of hil_navigation");
_Static_assert(offsetof(hil_navigation, valid) == 0, "place of hil_navigation.valid");
_Static_assert(offsetof(hil_navigation, r_CT_H) == 8, "place of hil_navigation.r_CT_H");
_Static_assert(offsetof(hil_navigation, v_CT_H) == 32, "place of hil_navigation.v_CT_H");
_Static_assert(offsetof(hil_navigation, q_CH) == 56, "place of hil_navigation.q_CH");
_Static_assert(offsetof(hil_navigation, w_CH_C) == 88, "place of hil_navigation.w_CH_C");
_Static_assert(offsetof(hil_navigation, sigma_r_m) == 112, "place of hil_navigation.sigma_r_m");
_Static_assert(offsetof(hil_navigation, sigma_v_mps) == 136, "place of hil_navigation.sigma_v_mps");
_Static_assert(offsetof(hil_navigation, sigma_attitude_rad) == 160, "place of hil_navigation.sigma_attitude_rad");
_Static_assert(offsetof(hil_navigation, nis_position) == 184, "place of hil_navigation.nis_position");
_Static_assert(offsetof(hil_navigation, nis_attitude) == 192, "place of hil_navigation.nis_attitude");
_Static_assert(offsetof(hil_navigation, protection_level_m) == 200, "place of hil_navigation.protection_level_m");
_Static_assert(offsetof(hil_navigation, protection_level_rad) == 224, "place of hil_navigation.protection_level_rad");
_Static_assert(offsetof(hil_navigation, health) == 232, "place of hil_navigation.health");
_Static_assert(sizeof(hil_reference) == 168, "size of hil_reference");
_Static_assert(offsetof(hil_reference, r_CT_H) == 0, "place of hil_reference.r_CT_H");
_Static_assert(offsetof(hil_reference, v_CT_H) == 24, "place of hil_reference.v_CT_H");
_Static_assert(offsetof(hil_reference, a_CT_H) == 48, "place of hil_reference.a_CT_H");
_Static_assert(offsetof(hil_reference, q_CH) == 72, "place of hil_reference.q_CH");
_Static_assert(offsetof(hil_reference, boost) == 104, "place of hil_reference.boost");
_Static_assert(offsetof(hil_reference, phase) == 112, "place of hil_reference.phase");
_Static_assert(offsetof(hil_reference, from_H) == 120, "place of hil_reference.from_H");
_Static_assert(offsetof(hil_reference, to_H) == 144, "place of hil_reference.to_H");
_Static_assert(sizeof(hil_navigation_input) == 11936, "size of hil_navigation_input");
_Static_assert(offsetof(hil_navigation_input, cycle) == 0, "place of hil_navigation_input.cycle");
_Static_assert(offsetof(hil_navigation_input, t_s) == 8, "place of hil_navigation_input.t_s");
_Static_assert(offsetof(hil_navigation_input, mode) == 16, "place of hil_navigation_input.mode");
_Static_assert(offsetof(hil_navigation_input, orders) == 20, "place of hil_navigation_input.orders");
_Static_assert(offsetof(hil_navigation_input, imu_suspect) == 24, "place of hil_navigation_input.imu_suspect");
_Static_assert(offsetof(hil_navigation_input, n_samples) == 32, "place of hil_navigation_input.n_samples");
_Static_assert(offsetof(hil_navigation_input, n_poses) == 40, "place of hil_navigation_input.n_poses");
_Static_assert(offsetof(hil_navigation_input, second_bound_m) == 48, "place of hil_navigation_input.second_bound_m");
_Static_assert(offsetof(hil_navigation_input, second_bound_s) == 56, "place of hil_navigation_input.second_bound_s");
_Static_assert(offsetof(hil_navigation_input, fault) == 64, "place of hil_navigation_input.fault");
_Static_assert(offsetof(hil_navigation_input, fault_thruster) == 72, "place of hil_navigation_input.fault_thruster");
_Static_assert(offsetof(hil_navigation_input, commanded) == 80, "place of hil_navigation_input.commanded");
_Static_assert(offsetof(hil_navigation_input, isolated) == 104, "place of hil_navigation_input.isolated");
_Static_assert(offsetof(hil_navigation_input, samples) == 128, "place of hil_navigation_input.samples");
_Static_assert(offsetof(hil_navigation_input, poses) == 3200, "place of hil_navigation_input.poses");
_Static_assert(offsetof(hil_navigation_input, setup) == 4352, "place of hil_navigation_input.setup");
_Static_assert(offsetof(hil_navigation_input, n_measurements) == 5912, "place of hil_navigation_input.n_measurements");
_Static_assert(offsetof(hil_navigation_input, measurements) == 5920, "place of hil_navigation_input.measurements");
_Static_assert(sizeof(hil_navigation_output) == 360, "size of hil_navigation_output");
_Static_assert(offsetof(hil_navigation_output, state) == 0, "place of hil_navigation_output.state");
_Static_assert(offsetof(hil_navigation_output, valid) == 8, "place of hil_navigation_output.valid");
_Static_assert(offsetof(hil_navigation_output, r_CT_H) == 16, "place of hil_navigation_output.r_CT_H");
_Static_assert(offsetof(hil_navigation_output, v_CT_H) == 40, "place of hil_navigation_output.v_CT_H");
_Static_assert(offsetof(hil_navigation_output, q_CH) == 64, "place of hil_navigation_output.q_CH");
_Static_assert(offsetof(hil_navigation_output, w_CH_C) == 96, "place of hil_navigation_output.w_CH_C");
_Static_assert(offsetof(hil_navigation_output, sigma_r_m) == 120, "place of hil_navigation_output.sigma_r_m");
_Static_assert(offsetof(hil_navigation_output, sigma_v_mps) == 144, "place of hil_navigation_output.sigma_v_mps");
_Static_assert(offsetof(hil_navigation_output, sigma_attitude_rad) == 168, "place of hil_navigation_output.sigma_attitude_rad");
_Static_assert(offsetof(hil_navigation_output, nis_position) == 192, "place of hil_navigation_output.nis_position");
_Static_assert(offsetof(hil_navigation_output, nis_attitude) == 200, "place of hil_navigation_output.nis_attitude");
_Static_assert(offsetof(hil_navigation_output, protection_level_m) == 208, "place of hil_navigation_output.protection_level_m");
_Static_assert(offsetof(hil_navigation_output, protection_level_rad) == 232, "place of hil_navigation_output.protection_level_rad");
_Static_assert(offsetof(hil_navigation_output, health) == 240, "place of hil_navigation_output.health");
_Static_assert(offsetof(hil_navigation_output, bias_mps2) == 248, "place of hil_navigation_output.bias_mps2");
_Static_assert(offsetof(hil_navigation_output, bias_sigma_mps2) == 272, "place of hil_navigation_output.bias_sigma_mps2");
_Static_assert(offsetof(hil_navigation_output, text) == 296, "place of hil_navigation_output.text");
_Static_assert(sizeof(hil_control_input) == 2152, "size of hil_control_input");
_Static_assert(offsetof(hil_control_input, cycle) == 0, "place of hil_control_input.cycle");
_Static_assert(offsetof(hil_control_input, t_s) == 8, "place of hil_control_input.t_s");
_Static_assert(offsetof(hil_control_input, mode) == 16, "place of hil_control_input.mode");
_Static_assert(offsetof(hil_control_input, orders) == 20, "place of hil_control_input.orders");
_Static_assert(offsetof(hil_control_input, phase) == 24, "place of hil_control_input.phase");
_Static_assert(offsetof(hil_control_input, reaction) == 32, "place of hil_control_input.reaction");
_Static_assert(offsetof(hil_control_input, aborted) == 40, "place of hil_control_input.aborted");
_Static_assert(offsetof(hil_control_input, fault) == 48, "place of hil_control_input.fault");
_Static_assert(offsetof(hil_control_input, fault_thruster) == 56, "place of hil_control_input.fault_thruster");
_Static_assert(offsetof(hil_control_input, isolated) == 64, "place of hil_control_input.isolated");
_Static_assert(offsetof(hil_control_input, withheld) == 88, "place of hil_control_input.withheld");
_Static_assert(offsetof(hil_control_input, navigation) == 112, "place of hil_control_input.navigation");
_Static_assert(offsetof(hil_control_input, reference) == 352, "place of hil_control_input.reference");
_Static_assert(offsetof(hil_control_input, feed_force_mps2) == 520, "place of hil_control_input.feed_force_mps2");
_Static_assert(offsetof(hil_control_input, feed_torque_radps2) == 544, "place of hil_control_input.feed_torque_radps2");
_Static_assert(offsetof(hil_control_input, reference_rate_radps) == 568, "place of hil_control_input.reference_rate_radps");
_Static_assert(offsetof(hil_control_input, setup) == 592, "place of hil_control_input.setup");
_Static_assert(sizeof(hil_control_output) == 120, "size of hil_control_output");
_Static_assert(offsetof(hil_control_output, state) == 0, "place of hil_control_output.state");
_Static_assert(offsetof(hil_control_output, direct) == 4, "place of hil_control_output.direct");
_Static_assert(offsetof(hil_control_output, force) == 8, "place of hil_control_output.force");
_Static_assert(offsetof(hil_control_output, torque) == 20, "place of hil_control_output.torque");
_Static_assert(offsetof(hil_control_output, on) == 32, "place of hil_control_output.on");
_Static_assert(offsetof(hil_control_output, text) == 56, "place of hil_control_output.text");
#endif

#ifdef __cplusplus
}
#endif
#endif
