/* How the observer is called where it is stepped every few interrupts only: the current control
 * interrupts every @sample_time@ s, the observer takes a step every @step_time@ s and
 * volt-seconds are gathered in between, so that none are lost.
 * What is yours stands in the four functions declared here. Compile with -DFO_SINGLE.
 *
 *      t[k-1]               t[k]                 t[k+1]
 *        |  `acting` acts    |  `next` acts       |  what is commanded now acts
 *      interrupt           interrupt: i[k] sampled
 */
#include "@prefix@.h"

void drive_read_currents(float i_abc[3]);             /* [A], positive into the machine */
float drive_read_dc_link(void);                       /* [V] */
void drive_current_control(const float i[2], float theta_e, float speed_e, int position_known,
                           float udc, float command[2]);
void drive_write_voltage(const float command[2], float udc);
void drive_start(void);
void current_control_interrupt(void);

static fo_state state;
static fo_estimate estimate;
static fo_gathered gathered;
static int since_step;  /* interrupts since the observer's last step */
static float acting[2]; /* mean voltage, alpha and beta [V], over the interval that ends now */
static float next[2];   /* over the one that begins now: commanded an interrupt ago */

void drive_start(void)
{
    static const fo_gathered nothing = {{0.0f, 0.0f}, {0.0f, 0.0f}};
    fo_reset(&@prefix@_observer, &state);
    gathered = nothing;
    since_step = 0;
    acting[0] = acting[1] = 0.0f; /* no voltage is applied yet */
    next[0] = next[1] = 0.0f;
}

void current_control_interrupt(void)
{
    const float share = 1.0f / (float)@PREFIX@_UPDATE_EVERY;
    float i_abc[3], i[2], command[2];
    const float udc = drive_read_dc_link();
    drive_read_currents(i_abc);

    /* Clarke's transform, amplitude-invariant; with two sensors i_c = -i_a - i_b. */
    i[0] = (2.0f * i_abc[0] - i_abc[1] - i_abc[2]) / 3.0f;
    i[1] = (i_abc[1] - i_abc[2]) * 0.57735027f;

    fo_gather(&@prefix@_observer, &gathered, share, acting, i);
    since_step++;
    if (since_step == @PREFIX@_UPDATE_EVERY) {
        fo_step_volt_seconds(&@prefix@_observer, &state, gathered.volt_seconds, i, &estimate);
        gathered.volt_seconds[0] = gathered.volt_seconds[1] = 0.0f;
        since_step = 0;
    }

    /* Between steps the rotor goes on at its speed. Wrap the angle where your control asks for it. */
    const float ahead = (float)since_step * share * @prefix@_observer.sample_time;
    drive_current_control(i, estimate.theta_e_tracked + estimate.speed_e * ahead,
                          estimate.speed_e, estimate.valid, udc, command);

    /* Limited by the modulator? Then `command` has to hold what is applied, not what was wanted:
     * keep it within the hexagon of udc before it is written. */
    drive_write_voltage(command, udc);

    /* The PWM takes the new duties at t[k+1], one interrupt from now. Where it takes them at once,
     * `next` falls away: acting = command. */
    acting[0] = next[0];
    acting[1] = next[1];
    next[0] = command[0];
    next[1] = command[1];
}
