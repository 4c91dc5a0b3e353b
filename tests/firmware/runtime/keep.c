/* For an exported folder. The blob beside the folder must contain the observer of the source,
 * unpacking must undo packing, any damaged byte must be detected, and learnt values must be
 * restored. Argument: the blob. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fluxobs_keep.h"
#include "motor_observer.h"
#include "vectors.h"

static int failures = 0;

static void demand_that(bool good, const char *what)
{
    if (!good) {
        printf("%s\n", what);
        failures++;
    }
}

#ifdef ADAPTIVE
#define OBSERVER fo_adaptive
#define PACK fo_adaptive_pack
#define UNPACK fo_adaptive_unpack
#define BYTES FO_ADAPTIVE_PACKED_BYTES
#define PLAIN_OF(o) (&(o).plain)
#else
#define OBSERVER fo_observer
#define PACK fo_pack
#define UNPACK fo_unpack
#define BYTES FO_PACKED_BYTES
#define PLAIN_OF(o) (&(o))
#endif

static uint8_t blob[4096], again[4096];

static void check_parameters(const char *path)
{
    static OBSERVER read;
    FILE *file = fopen(path, "rb");
    const uint32_t length = file ? (uint32_t)fread(blob, 1, sizeof blob, file) : 0;
    demand_that(length == BYTES, "the blob has another length");
    demand_that(UNPACK(&read, blob, length) == FO_OK, "the blob is refused");
#if FO_MAPPED
    PLAIN_OF(read)->map = PLAIN_OF(motor_observer)->map;
#endif
    demand_that(memcmp(&read, &motor_observer, sizeof read) == 0, "other numbers than in the source");
    PACK(&motor_observer, again);
    demand_that(memcmp(blob, again, BYTES) == 0, "packing writes other bytes");
    for (uint32_t n = 0; n < BYTES; n++) {
        const OBSERVER before = read;
        blob[n] ^= 0x10U;
        demand_that(UNPACK(&read, blob, length) == FO_ERROR_DAMAGED, "damage is not seen");
        demand_that(memcmp(&read, &before, sizeof read) == 0, "a refused blob was read");
        blob[n] ^= 0x10U;
    }
    for (uint32_t n = 0; n < BYTES; n++) {
        demand_that(UNPACK(&read, blob, n) == FO_ERROR_DAMAGED, "a part is taken for a whole");
    }
    if (file) {
        fclose(file);
    }
}

#ifdef ADAPTIVE
static void check_learnt(void)
{
    static fo_adaptive_state state, restored;
    static fo_adaptive other;
    fo_adaptive_estimate e;
    fo_learnt before, after;
    const fo_real R = (fo_real)24 * motor_observer.plain.hR[0][0] / motor_observer.volt;
    const fo_real warm = (fo_real)0.2 * R;
    fo_adaptive_reset(&motor_observer, &state);
    for (int k = 0; k < SAMPLES; k++) {
        fo_adaptive_step(&motor_observer, &state, &samples[k][0], &samples[k][2], &e);
    }
    fo_adaptive_learnt(&motor_observer, &state, &before);
    demand_that(before.resistance_std < motor_observer.std[FO_RESISTANCE], "nothing was learnt");
    fo_adaptive_save(&motor_observer, &state, blob);
    demand_that(fo_adaptive_restore(&motor_observer, &restored, blob, FO_SAVED_BYTES, 0) == FO_OK,
                "what was saved is refused");
    fo_adaptive_learnt(&motor_observer, &restored, &after);
    demand_that(memcmp(&before, &after, sizeof before) == 0, "what was learnt is not restored");
    fo_adaptive_restore(&motor_observer, &restored, blob, FO_SAVED_BYTES, (fo_real)0.2);
    fo_adaptive_learnt(&motor_observer, &restored, &after);
    const fo_real wanted = before.resistance_std * before.resistance_std + warm * warm;
    const fo_real found = after.resistance_std * after.resistance_std;
    demand_that(found > (fo_real)0.999 * wanted && found < (fo_real)1.001 * wanted,
                "heat does not widen the resistance");
    for (uint32_t n = 0; n < FO_SAVED_BYTES; n++) {
        blob[n] ^= 0x04U;
        demand_that(fo_adaptive_restore(&motor_observer, &restored, blob, FO_SAVED_BYTES, 0) ==
                        FO_ERROR_DAMAGED,
                    "damage of what was learnt is not seen");
        blob[n] ^= 0x04U;
    }
    fo_adaptive_learnt(&motor_observer, &restored, &after);
    demand_that(after.resistance_error == 0 && after.resistance_std > before.resistance_std,
                "a refused save has left something");
    other = motor_observer; /* assume another resistance now */
    other.plain.hR[0][0] *= (fo_real)1.25;
    other.plain.hR[1][1] *= (fo_real)1.25;
    demand_that(fo_adaptive_restore(&other, &restored, blob, FO_SAVED_BYTES, 0) == FO_OK,
                "another resistance is refused");
    fo_adaptive_learnt(&other, &restored, &after);
    const fo_real off = before.resistance_error - (fo_real)0.25 * R - after.resistance_error;
    const fo_real share = before.resistance_std / motor_observer.std[FO_RESISTANCE];
    const fo_real most = R * ((fo_real)1e-5 + (fo_real)0.5 * share * share); /* the prior changes */
    demand_that(off * off < most * most, "the resistance has changed");
    fo_adaptive_restore(&motor_observer, &restored, blob, FO_SAVED_BYTES, (fo_real)INFINITY);
    fo_adaptive_learnt(&motor_observer, &restored, &after);
    demand_that(after.resistance_std > motor_observer.std[FO_RESISTANCE] &&
                    after.resistance_std < (fo_real)1e4 * R && after.psi_f > 0,
                "an endless change leaves nothing usable");
    memset(&state, 0, sizeof state); /* as before the first step */
    fo_adaptive_save(&motor_observer, &state, blob);
    demand_that(fo_adaptive_restore(&motor_observer, &restored, blob, FO_SAVED_BYTES, 0) == FO_OK,
                "a state of zeros cannot be saved");
    fo_adaptive_learnt(&motor_observer, &restored, &after);
    demand_that(after.resistance_std > (fo_real)0.99 * motor_observer.std[FO_RESISTANCE] &&
                    after.resistance_std < (fo_real)1.01 * motor_observer.std[FO_RESISTANCE],
                "a state of zeros was taken for knowledge");
    for (int k = 0; k < SAMPLES; k++) { /* learn again for the next test */
        fo_adaptive_step(&motor_observer, &state, &samples[k][0], &samples[k][2], &e);
    }
    fo_adaptive_save(&motor_observer, &state, blob);
    other = motor_observer;
    other.std[FO_RESISTANCE] *= (fo_real)1.0625;
    demand_that(fo_adaptive_restore(&other, &restored, blob, FO_SAVED_BYTES, 0) == FO_ERROR_OTHER,
                "another machine takes it");
}
#endif

int main(int count, char **given)
{
    if (count != 2) {
        return 2;
    }
    check_parameters(given[1]);
#ifdef ADAPTIVE
    check_learnt();
#endif
    return failures > 0 ? 1 : 0;
}
