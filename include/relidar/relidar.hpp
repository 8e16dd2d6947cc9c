// SPDX-License-Identifier: Apache-2.0
// Includes all headers that applications need for logs, runs and scans. The components of
// the training loop are in <relidar/diff/...>.
//
// Objects created from a Device must be destroyed before the device. Only one thread at a
// time may use a Device and its objects. Two threads may use two devices. Any thread may
// call functions that use no device. Errors are thrown as relidar::Error
// (relidar/base/error.hpp).
#pragma once

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/log.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/log/sensor.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/read/packets.hpp>
#include <relidar/registration/registration.hpp>
#include <relidar/run/blocks.hpp>
#include <relidar/run/config.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/camera.hpp>
#include <relidar/simulate/place_points.hpp>
#include <relidar/simulate/point_files.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>
#include <relidar/simulate/weather.hpp>
#include <relidar/train/train.hpp>
