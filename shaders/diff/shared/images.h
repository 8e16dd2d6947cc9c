// SPDX-License-Identifier: Apache-2.0
// Layout of the images of the ray-drop network: [n_images, channels, rows, columns].
// Neighbouring columns are adjacent in memory.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_IMAGES_H
#define RELIDAR_INCLUDED_DIFF_SHARED_IMAGES_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

struct ImageSlice {
    Floats values;
    uint channels;  // number of channels of the images
    uint first;     // first channel of the slice
};

RELIDAR_SHARED_END
#endif
