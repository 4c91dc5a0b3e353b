/* The filter without derivatives by parameters: for the objective, and for smoothing with exact parameters.
 *
 * The sources of the filter are compiled twice. With FO_VALUES_ONLY, fo_dual is one number, and these
 * functions have other names. */
#ifndef FLUXOBS_VALUES_H
#define FLUXOBS_VALUES_H

#ifdef FO_VALUES_ONLY
#define fo_model_of fo_model_of_values
#define fo_predict fo_predict_values
#define fo_flux_of fo_flux_of_values
#define fo_flux_at fo_flux_at_values
#define fo_signs_of fo_signs_of_values
#define fo_elements_of fo_elements_of_values
#define fo_innovations fo_innovations_of_values
#define fo_again fo_again_of_values
#endif

#endif
