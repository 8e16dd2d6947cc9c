// SPDX-License-Identifier: Apache-2.0
// Names of object classes in the published layouts.
#pragma once

#include <string>

namespace relidar::layouts {

/// Names of a class of objects. Numbers are those of SemanticKITTI.
struct ObjectNames {
    const char* kitti;
    const char* nuscenes;
    int still_class, moving_class;
};

/// Returns the names for a class name of any dataset.
ObjectNames find_object_names(const std::string& category);

/// Returns the name of nuScenes. Keeps a name that already has the form of nuScenes.
std::string nuscenes_category(const std::string& category);

}  // namespace relidar::layouts
