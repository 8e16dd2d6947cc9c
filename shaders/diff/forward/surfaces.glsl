// SPDX-License-Identifier: Apache-2.0
// The surfaces that a ray meets (docs/method.md M13): a hit farther behind the one before
// it than a gap begins another one. Hits come nearest first, so one pass finds the
// heaviest.
#ifndef RELIDAR_INCLUDED_DIFF_FORWARD_SURFACES_GLSL
#define RELIDAR_INCLUDED_DIFF_FORWARD_SURFACES_GLSL
RELIDAR_CONSTANT(uint, MODE, 0u);

struct Surfaces {
    float last_t;      // of the hit before
    float start;       // t of the first hit of the present surface
    float weight;      // of the present surface
    float moment;      // sum w (t - start) over it
    float heaviest;    // weight of the heaviest surface so far
    float heaviest_t;  // mean of t over it
};

Surfaces no_surfaces() { return Surfaces(-1e30, 0.0, 0.0, 0.0, 0.0, 0.0); }

/// Takes the present surface for the heaviest where it is; of equals the nearer one
/// stays.
void weigh_surface(inout Surfaces s) {
    if (!(s.weight > s.heaviest)) return;
    s.heaviest = s.weight;
    s.heaviest_t = s.start + s.moment / s.weight;
}

void add_to_surface(float t, float w, float gap, inout Surfaces s) {
    if (t - s.last_t > gap) {
        weigh_surface(s);
        s.start = t;
        s.weight = s.moment = 0.0;
    }
    s.last_t = t;
    s.weight += w;
    s.moment += w * (t - s.start);
}
#endif
