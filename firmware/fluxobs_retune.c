/* SPDX-License-Identifier: MIT */
#include "fluxobs_retune.h"

#include "fluxobs_internal.h"
#if FO_ADAPTIVE
#include "fluxobs_learning.h"
#endif

static bool equal(fo_real a, fo_real b) { return !(a < b) && !(a > b); }

/* Do both observers have the same units of the state? */
static bool same_units(const fo_observer *a, const fo_observer *b)
{
    return equal(a->flux_base, b->flux_base) && equal(a->h, b->h) &&
           equal(a->drift_base, b->drift_base) && equal(a->Q1x2[0][0], b->Q1x2[0][0]) &&
           equal(a->Q1x2[1][1], b->Q1x2[1][1]);
}

void fo_retunable_init(fo_retunable *r, const fo_observer *first)
{
    r->both[0] = *first;
    r->active = 0U;
    r->ready = 0U;
}

fo_error fo_retune(fo_retunable *r, const fo_config *config)
{
    const uint32_t active = r->active;
    fo_error result = FO_ERROR_BUSY;
    if (r->ready == active) {
        fo_observer *spare = &r->both[1U - active];
        result = fo_init(spare, config);
        if (result == FO_OK && !same_units(spare, &r->both[active])) {
            result = FO_ERROR_OTHER;
        }
#if FO_MAPPED
        spare->map = r->both[active].map;
#endif
        if (result == FO_OK) {
            FO_BARRIER();
            r->ready = 1U - active;
        }
    }
    return result;
}

const fo_observer *fo_take(fo_retunable *r)
{
    const uint32_t ready = r->ready;
    FO_BARRIER();
    r->active = ready;
    return &r->both[ready];
}

#if FO_ADAPTIVE
void fo_adaptive_retunable_init(fo_adaptive_retunable *r, const fo_adaptive *first)
{
    r->both[0] = *first;
    r->active = 0U;
    r->ready = 0U;
}

/* Have the learnt parameters the same units? Prior means of the inductances must not change. */
static bool same_learnt_units(const fo_adaptive *a, const fo_adaptive *b)
{
    bool good = same_units(&a->plain, &b->plain) && equal(a->saliency, b->saliency) &&
                equal(a->plain.L_position, b->plain.L_position);
    for (int i = 0; i < (int)FO_NP; i++) {
        good = good && equal(a->std[i], b->std[i]);
    }
    return good;
}

fo_error fo_adaptive_retune(fo_adaptive_retunable *r, const fo_config *config,
                            const fo_adaptive_config *adaptive)
{
    const uint32_t active = r->active;
    fo_error result = FO_ERROR_BUSY;
    if (r->ready == active) {
        fo_adaptive *spare = &r->both[1U - active];
        result = fo_adaptive_init(spare, config, adaptive);
        if (result == FO_OK && !same_learnt_units(spare, &r->both[active])) {
            result = FO_ERROR_OTHER;
        }
#if FO_MAPPED
        spare->plain.map = r->both[active].plain.map;
#endif
        if (result == FO_OK) {
            FO_BARRIER();
            r->ready = 1U - active;
        }
    }
    return result;
}

const fo_adaptive *fo_adaptive_take(fo_adaptive_retunable *r, fo_adaptive_state *s)
{
    const uint32_t ready = r->ready;
    FO_BARRIER();
    if (ready != r->active) { /* the estimates stay: their errors change by the opposite amount */
        fo_real before[FO_PRIOR_MEANS], now[FO_PRIOR_MEANS];
        fo_learning_prior_means(&r->both[r->active], before);
        fo_learning_prior_means(&r->both[ready], now);
        fo_learning_shift_values(before, now, s->value);
    }
    r->active = ready;
    return &r->both[ready];
}

const fo_adaptive *fo_adaptive_in_use(const fo_adaptive_retunable *r)
{
    return &r->both[r->active];
}
#endif

void fo_publish(fo_snapshot *s, const fo_estimate *estimate)
{
    const uint32_t before = s->begun;
    const uint32_t count = before < UINT32_MAX ? before + 1U : 1U; /* 0: no estimate exists yet */
    s->begun = count;
    FO_BARRIER();
    s->estimate = *estimate;
    FO_BARRIER();
    s->ended = count;
}

bool fo_read(const fo_snapshot *s, fo_estimate *estimate)
{
    bool whole = false;
    for (int tries = 0; tries < 4 && !whole; tries++) {
        const uint32_t before = s->ended;
        FO_BARRIER();
        *estimate = s->estimate;
        FO_BARRIER();
        whole = s->begun == before && before != 0U;
    }
    return whole;
}
