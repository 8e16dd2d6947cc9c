// SPDX-License-Identifier: Apache-2.0
// Everything that a user of logs, runs and scans needs, in one line. What trainers are built from is in <relidar/stages/...>.
//
// Objects made from a Device must go before it does. A Device and what was made from it belong to one thread at a time; two devices may be
// used by two threads. Functions without a device may be called by any thread. Failures are thrown as relidar::Error (error.hpp).
#pragma once

#include <relidar/assets.hpp>
#include <relidar/blocks.hpp>
#include <relidar/config.hpp>
#include <relidar/coverage.hpp>
#include <relidar/dataset.hpp>
#include <relidar/edit.hpp>
#include <relidar/error.hpp>
#include <relidar/evaluation.hpp>
#include <relidar/export.hpp>
#include <relidar/gpu.hpp>
#include <relidar/math.hpp>
#include <relidar/metrics.hpp>
#include <relidar/progress.hpp>
#include <relidar/registration.hpp>
#include <relidar/render.hpp>
#include <relidar/run.hpp>
#include <relidar/scan_files.hpp>
#include <relidar/scatter.hpp>
#include <relidar/scene.hpp>
#include <relidar/sensor.hpp>
#include <relidar/sensor_files.hpp>
#include <relidar/sequence.hpp>
#include <relidar/process_group.hpp>
#include <relidar/train.hpp>
#include <relidar/weather.hpp>
