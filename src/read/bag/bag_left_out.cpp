// SPDX-License-Identifier: Apache-2.0
// Replaces the bag reader if its libraries are missing or RELIDAR_BAGS is off. Loading a
// recording then throws an error.

#include "base/fail.hpp"
#include "read/readers.hpp"

namespace relidar {

Log load_ros_bag(const std::filesystem::path& path, const DatasetOptions&) {
    fail<UsageError>(
        "{}: this relidar was built without the reader of ROS bags; install libsqlite3-dev and libbz2-dev, "
        "and build it again with RELIDAR_BAGS=ON",
        path.string());
}

}  // namespace relidar
