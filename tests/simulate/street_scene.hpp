// SPDX-License-Identifier: Apache-2.0
// Synthetic street for tests of renderings.
#pragma once

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/render.hpp>

#include "../support/device.hpp"

namespace relidar::test {

/// The scene has the training frames of the street and was not trained.
class StreetTest : public DeviceTest {
protected:
    /// @param test_every 5: every fifth frame is a test frame; 0: none is
    explicit StreetTest(const StreetOptions& options, int test_every = 0, const InitOptions& init = {})
        : log(make_street_log(options)),
          split(split_frames(log, test_every)),
          scene(init_scene(log, split.train, init)) {}

    Log log;
    Split split;
    Scene scene;
    Config config;
};

}  // namespace relidar::test
