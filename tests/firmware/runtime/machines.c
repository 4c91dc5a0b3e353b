/* Impossible machines and wrong units: fo_configure must name the number, and fo_init must refuse
 * the configuration. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fluxobs_config.h"

static int failures = 0;
static const fo_real H = (fo_real)5e-5, MOST = (fo_real)INFINITY, NANS = (fo_real)NAN;

static void expect(const char *motor, const fo_machine *m, fo_real sample_time, const char *field)
{
    fo_config config;
    fo_observer observer;
    const char *found = fo_configure(&config, m, sample_time);
    const fo_error error = fo_init(&observer, &config);
    if (field == NULL ? found != NULL || error != FO_OK
                      : found == NULL || strcmp(found, field) != 0 || error == FO_OK) {
        printf("%s: %s expected, %s named, error %d\n", motor, field ? field : "nothing",
               found ? found : "nothing", (int)error);
        failures++;
    }
}

/* Multiplies one number of a machine by a factor, or replaces it. */
static void times(const char *motor, const fo_machine *m, size_t offset, fo_real factor, const char *field)
{
    fo_machine changed = *m;
    fo_real *number = (fo_real *)(void *)((unsigned char *)&changed + offset);
    *number *= factor;
    expect(motor, &changed, H, field);
}

static void set(const char *motor, const fo_machine *m, size_t offset, fo_real value, const char *field)
{
    fo_machine changed = *m;
    *(fo_real *)(void *)((unsigned char *)&changed + offset) = value;
    expect(motor, &changed, H, field);
}

#define AT(name) offsetof(fo_machine, name)

static void impossible(const char *motor, const fo_machine *m, size_t offset, const char *field)
{
    set(motor, m, offset, NANS, field);
    set(motor, m, offset, MOST, field);
    set(motor, m, offset, (fo_real)0, field);
    set(motor, m, offset, (fo_real)-0.5, field);
}

/* A machine with a number just within its limit is accepted. If the number is just beyond, `field`
 * is named. */
static void both_sides(const fo_machine *m, size_t offset, bool most, const char *field)
{
    const fo_real little = (fo_real)1e-4;
    times("within a limit", m, offset, most ? 1 - little : 1 + little, NULL);
    times("beyond a limit", m, offset, most ? 1 + little : 1 - little, field);
}

static void check_limits(void)
{
    const fo_machine magnets[] = {
        /* R_s, L, psi, current: each ratio is at its lower or upper limit */
        fo_pmsm(1, (fo_real)2e-6, 1, 2000),          /* L/R of 2 us */
        fo_pmsm(1, 5, 1, 1),                         /* L/R of 5 s */
        fo_pmsm(1, (fo_real)3e-3, 1, 1 / (fo_real)3), /* L i is a thousandth of psi */
        fo_pmsm(1, (fo_real)0.03, 1, 50 / (fo_real)0.03), /* L i is 50 times psi */
        fo_pmsm((fo_real)0.01, (fo_real)0.01, 1, 1), /* R i equals the EMF at 0.01 rad/s */
        fo_pmsm(1, (fo_real)1e-4, 1, (fo_real)2e4),  /* R i equals the EMF at 20 000 rad/s */
    };
    both_sides(&magnets[2], AT(rated_current), false, "psi or rated_current");
    both_sides(&magnets[3], AT(rated_current), true, "psi or rated_current");
    both_sides(&magnets[4], AT(R_s), false, "R_s");
    both_sides(&magnets[5], AT(R_s), true, "R_s");
    both_sides(&magnets[1], AT(R_s), false, "R_s");
    fo_machine scaled = magnets[0];
    for (int side = -1; side <= 1; side += 2) {
        scaled.L_q = magnets[0].L_q * (1 + (fo_real)1e-4 * (fo_real)side);
        scaled.L_d = scaled.L_q;
        expect("L/R", &scaled, H, side < 0 ? "L_q" : NULL);
    }
    fo_machine salient = fo_ipmsm((fo_real)3.6, (fo_real)36e-3, (fo_real)36e-3, (fo_real)0.545, 6);
    salient.L_d = 50 * salient.L_q;
    both_sides(&salient, AT(L_d), true, "L_d");
    salient.L_d = salient.L_q / 50;
    both_sides(&salient, AT(L_d), false, "L_d");
    fo_machine cage = fo_induction((fo_real)3.7, (fo_real)2.24, (fo_real)21e-3, (fo_real)0.224, 1, 7);
    cage.R_R = cage.L_M * 1000;
    both_sides(&cage, AT(R_R), true, "R_R");
    cage.R_R = cage.L_M / 100;
    both_sides(&cage, AT(R_R), false, "R_R");
    /* L_M is the cause of an implausible ratio to L_sigma */
    cage.L_M = cage.L_q;
    cage.R_R = cage.L_M * 2000;
    expect("L_M as L_sigma", &cage, H, "R_R");
    cage.L_M *= (fo_real)0.999;
    expect("L_M below L_sigma", &cage, H, "L_M");
    cage.L_M = cage.L_q * (fo_real)999;
    cage.R_R = cage.L_M * 2000;
    expect("L_M below 1000 L_sigma", &cage, H, "R_R");
    cage.L_M = cage.L_q * (fo_real)1001;
    cage.R_R = cage.L_M * 2000;
    expect("L_M beyond 1000 L_sigma", &cage, H, "L_M");
    const fo_machine servo = fo_pmsm((fo_real)0.36, (fo_real)0.6e-3, (fo_real)0.0125, 12);
    /* the usual memory, 30 ms, is 9.99 to 1.001e6 samples here */
    expect("long samples", &servo, (fo_real)3.002e-3, NULL);
    expect("longer samples", &servo, (fo_real)3.004e-3, "sample_time");
    expect("short samples", &servo, (fo_real)2.998e-8, NULL);
    expect("shorter samples", &servo, (fo_real)2.996e-8, "sample_time");
}

int main(void)
{
    check_limits();
    const fo_real k = (fo_real)1000;
    const struct {
        const char *name;
        fo_machine machine;
    } motors[] = {
        {"servo-400w", fo_pmsm((fo_real)0.36, (fo_real)0.6e-3, (fo_real)0.0125, (fo_real)12)},
        {"drone-900kv", fo_pmsm((fo_real)0.05, (fo_real)20e-6, (fo_real)0.0011, (fo_real)30)},
        {"pmsm-2kw2", fo_pmsm((fo_real)3.6, (fo_real)36e-3, (fo_real)0.545, (fo_real)6.1)},
        {"ipm-2kw2", fo_ipmsm((fo_real)3.6, (fo_real)36e-3, (fo_real)51e-3, (fo_real)0.545, (fo_real)6.1)},
        {"synrm-6kw7", fo_synrm((fo_real)0.54, (fo_real)41.5e-3, (fo_real)6.2e-3, (fo_real)21.9)},
        {"induction-2kw2", fo_induction((fo_real)3.7, (fo_real)2.1, (fo_real)21e-3, (fo_real)224e-3,
                                        (fo_real)0, (fo_real)7.1)},
    };
    for (size_t n = 0; n < sizeof motors / sizeof motors[0]; n++) {
        const char *name = motors[n].name;
        const fo_machine *m = &motors[n].machine;
        const bool salient = m->kind == FO_RELUCTANCE, cage = m->kind == FO_CAGE;
        expect(name, m, H, NULL);
        expect(name, m, NANS, "sample_time");
        expect(name, m, (fo_real)0, "sample_time");
        expect(name, m, -H, "sample_time");
        expect(name, m, (fo_real)50, "sample_time");   /* microseconds */
        expect(name, m, (fo_real)0.05, "sample_time"); /* milliseconds */
        expect(name, m, (fo_real)20e3, "sample_time"); /* a frequency  */
        impossible(name, m, AT(R_s), "R_s");
        impossible(name, m, AT(L_d), "L_d");
        impossible(name, m, AT(L_q), "L_q");
        impossible(name, m, AT(rated_current), "rated_current");
        set(name, m, AT(speed_e), NANS, "speed_e");
        set(name, m, AT(speed_e), (fo_real)-1, "speed_e");
        /* numbers in milliohms, millihenries, milliwebers, milliamperes */
        fo_machine both = *m;
        both.L_d *= k;
        both.L_q *= k;
        times(name, m, AT(R_s), k, salient ? "R_s or L_d and L_q" : "R_s");
        expect(name, &both, H, salient ? "R_s or L_d and L_q" : "L_q");
        if (!salient) {
            impossible(name, m, AT(psi), "psi");
            times(name, m, AT(psi), k, "psi or rated_current");
            times(name, m, AT(rated_current), k, "psi or rated_current");
        }
        if (cage) {
            impossible(name, m, AT(R_R), "R_R");
            impossible(name, m, AT(L_M), "L_M");
            times(name, m, AT(R_R), k, "R_R");
            times(name, m, AT(L_M), k, "L_M");
        }
        fo_machine other = *m;
        other.kind = (fo_kind)7;
        expect(name, &other, H, "kind");
    }
    fo_machine turned = motors[4].machine; /* here d is the axis of high permeance */
    turned.L_d = motors[4].machine.L_q;
    turned.L_q = motors[4].machine.L_d;
    expect("turned", &turned, H, "L_d");
    fo_machine unlike = motors[3].machine;
    unlike.L_d *= k;
    expect("unlike", &unlike, H, "L_d");
    return failures;
}
