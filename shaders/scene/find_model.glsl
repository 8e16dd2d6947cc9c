// SPDX-License-Identifier: Apache-2.0
// Finds the model that contains a surfel.
#ifndef RELIDAR_INCLUDED_SCENE_FIND_MODEL_GLSL
#define RELIDAR_INCLUDED_SCENE_FIND_MODEL_GLSL
#include "shared/scene.h"

/// Returns the index of the model that contains a surfel: the last model that starts at
/// or before this surfel. A model without surfels is never returned.
uint find_model(Models models, uint n_models, uint surfel) {
    uint low = 0u, high = n_models;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        if (models.at[middle].first_surfel <= surfel) low = middle;
        else high = middle;
    }
    return low;
}
#endif
