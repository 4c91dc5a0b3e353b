#include "direction.h"

#include <string.h>

/* The direction is measured if the squared changes are this multiple of those of the noise. */
#define RIPPLE_MIN 1.0
/* Correlation of a change with the one before, at most: it is -1 at half the sampling rate, 0 at a
 * quarter, and near 1 for loads and unequal sensors, which also change the residual. */
#define CORRELATION_MOST 0.45
/* An error e leaves sin(2e)/2; more is not an error of the angle [rad]. */
#define LARGEST_ERROR 0.5

/* M J⁻¹ g, and the squared size of M [H^2]. */
static vec response_to(const fo_relation *f, vec g, double *squares)
{
    const double determinant = f->by_d.re * f->by_q.im - f->by_d.im * f->by_q.re,
                 inverse = determinant > 0.0 ? 1.0 / determinant : 0.0;
    const vec d = times(inverse, vec_of(f->by_q.im * g.re - f->by_q.re * g.im,
                                        f->by_d.re * g.im - f->by_d.im * g.re));
    const double even = f->by_d.re - f->by_q.im, odd = f->by_q.re + f->by_d.im;
    *squares = even * even + odd * odd;
    return vec_of(even * d.re + odd * d.im, odd * d.re - even * d.im);
}

bool fo_add_ripple(fo_ripple *s, const fo_ripple_row *now, const fo_relation *f,
                   const fo_relation *given, bool measured, double rotation)
{
    const bool adds = measured && s->seen;
    vec response = vec_of(0.0, 0.0);
    if (adds) {
        const fo_ripple_row *last = &s->last;
        /* Both rows are seen from the angle between theirs: the noise of the current is in each
         * row's own angle. */
        const double away = 0.5 * (wrapped(now->angle - last->angle) - rotation);
        const vec turn = vec_of(1.0, away);
        const vec gain = minus(product(now->flux, turn), product(last->flux, conjugate(turn)));
        const vec rest = plus(minus(now->rest, last->rest),
                              times(away, turned(plus(now->auxiliary, last->auxiliary))));
        double saliency;
        response = response_to(given, gain, &saliency);
        const vec beside = turned(response);
        const double square = dot(response, response),
                     over = square > 0.0 ? 1.0 / sqrt(square) : 0.0;
        const vec noise_d = times(over * beside.re, vec_of(f->by_d.re, f->by_q.re)),
                  noise_q = times(over * beside.im, vec_of(f->by_d.im, f->by_q.im)),
                  noise = plus(noise_d, noise_q);
        s->rows += 1.0;
        s->product -= dot(rest, beside);
        s->square += square;
        s->lagged += dot(response, s->response);
        s->saliency += saliency;
        s->square_d += given->by_d.re * given->by_d.re;
        s->square_q += given->by_q.im * given->by_q.im;
        s->noise += dot(noise, noise);
        s->noise_d += dot(noise, noise_d);
        s->noise_q += dot(noise, noise_q);
        s->size += length_of(now->auxiliary);
    }
    s->response = response;
    s->seen = measured;
    s->last = *now;
    return adds;
}

bool fo_shows_direction(const fo_model *m, const fo_ripple *s)
{
    const double noise = 4.0 * m->current_noise * m->current_noise * s->saliency;
    return s->square > RIPPLE_MIN * noise && s->square > 0.0 &&
           s->lagged < CORRELATION_MOST * s->square;
}

double fo_direction_error(const fo_ripple *s)
{
    return clamp(s->product / s->square, -LARGEST_ERROR, LARGEST_ERROR);
}

double fo_direction_variance(const fo_model *m, const fo_ripple *s)
{
    const double noise = m->current_noise * m->current_noise * s->noise / s->rows;
    return 2.0 * noise * (s->square - s->lagged) / (s->square * s->square);
}

double fo_saliency_variance(const fo_model *m, const fo_ripple *s)
{
    const double d = m->std[FO_P_L_d], q = m->std[FO_P_L_q];
    return (d * d * s->square_d + q * q * s->square_q) / s->saliency;
}

void fo_next_ripple(fo_ripple *s)
{
    fo_ripple next;
    memset(&next, 0, sizeof next);
    next.last = s->last;
    next.seen = s->seen;
    next.response = s->response;
    *s = next;
}
