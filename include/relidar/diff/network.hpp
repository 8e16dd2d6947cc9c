// SPDX-License-Identifier: Apache-2.0
// Ray-drop as the sensor has it: a network that looks at a whole rendered scan and
// corrects the drop probability of each ray (paper, section 3.5, Eq. 12-13). Surfels know
// what a place returns; what the sensor makes of it (glass, dark paint, grazing beams,
// its own electronics) shows in the image.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>

namespace relidar {

/// The network and its training: config.refine.
struct RefineOptions {
    bool enabled = false;  ///< training ends with it, rendering uses it where a run has it
    /// "small", "paper" (6.5 million parameters; a tenth of its layers' values is dropped
    /// in training, and its images are turned about the sensor by random columns) or
    /// "pixel" (each pixel by itself)
    std::string network = "small";
    int width = 0;    ///< channels at full size; 0: the network's own
    int levels = -1;  ///< times that the image is halved; -1: the network's own
    /// what it looks at: "native", the sensor's rays, or "grid", the cells of
    /// config.sensor.grid
    std::string image = "native";
    /// its inputs about rays: "none", "direction" (its elevation) or "origin,direction"
    std::string rays = "direction";
    int frames = 64;     ///< training frames that it learns from at most, spread over all; 0: all
    int epochs = 4;      ///< each of them is seen so often
    int batch = 0;       ///< images in a training step; 0: the network's own number
    double rate = 2e-3;  ///< Adam's, at the start; it falls to a hundredth
    bool operator==(const RefineOptions&) const = default;
};

/// What the network sees of a scan with image order, and what came of it.
struct DropImage {
    int rows = 0, columns = 0;
    std::vector<float> channels;  ///< [channels of the network, rows, columns], see drop_channel_names()
    /// [rows, columns] 1 dropped, 0 returned, negative: not known; empty where nothing
    /// was measured
    std::vector<float> dropped;
};

/// Names of the network's channels in their order: "log_range", "intensity",
/// "drop_logit", "weight", "spread", "cosine" (of incidence), then those that belong to
/// the sensor's pixels: "elevation" (its sine, in the sensor's frame) and "origin_x" ...
/// "origin_z".
std::vector<std::string> drop_channel_names(const RefineOptions& options);

/// A trained network.
struct DropNetwork {
    std::string image = "native";       ///< what it was trained on: "native", or the name of a grid
    std::vector<std::string> inputs;    ///< channels it was trained with
    std::vector<std::uint32_t> widths;  ///< channels at full size, half, ...
    std::uint32_t heads = 0;            ///< of the attention at the smallest size; 0: none
    std::uint32_t taps = 9;             ///< of its convolutions: 9, or 1 where each pixel is by itself
    bool residual = true;               ///< its output is added to the rendered logit; false: it replaces it
    std::vector<float> normalisation;   ///< [channels, 2] scale and shift of the inputs
    std::vector<float> parameters;      ///< layer by layer, as the network is asked
    std::vector<float> running;         ///< moments of the normalisations, for evaluation

    bool empty() const { return parameters.empty(); }
    /// Rows and columns that an image needs.
    int smallest_side() const { return 1 << (widths.empty() ? 0 : widths.size() - 1); }
};

/// Trainable parameters of the options' network.
std::size_t count_parameters(const RefineOptions& options);

/// One epoch of a training.
struct RefineProgress {
    int epoch = 0, n_epochs = 0;
    int step = 0, n_steps = 0;
    double entropy = 0.0;   ///< mean cross-entropy of the epoch's pixels so far
    double accuracy = 0.0;  ///< share of pixels of which the likelier answer was right
    double seconds = 0.0;
};

/// A training after one of its steps: with the same images, options and seed it goes on
/// from here as if it had never stopped.
struct RefineState {
    int step = 0;                          ///< the last one that is done
    std::vector<float> parameters;         ///< [parameters] as in DropNetwork
    std::vector<float> moment1, moment2;   ///< [parameters] Adam's
    std::vector<float> running;            ///< as in DropNetwork
    double entropy = 0.0, accuracy = 0.0;  ///< sums over the steps of the epoch
    double seconds = 0.0;                  ///< of training so far

    /// Calls visit(name, value) for all that a checkpoint keeps.
    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("step", step);
        visit("parameters", parameters);
        visit("moment1", moment1);
        visit("moment2", moment2);
        visit("running", running);
        visit("entropy", entropy);
        visit("accuracy", accuracy);
        visit("seconds", seconds);
    }
};

/// Called after each step. @param state  copies the state from the device @return false
/// stops, and gives the network as it is
using RefineCallback =
    std::function<bool(const RefineProgress& progress, const std::function<RefineState()>& state)>;

/// Trains a network on images of one shape. The same seed gives the same network, to the
/// last bit on one device.
/// @param start  state to go on from, of a training with the same images, options and
/// seed; null: from the beginning
/// @throws DataError for images of different shapes, too small, with values that are not
/// finite, or without dropped pixels, and for a start of another network or with more
/// steps than there are; DeviceError if the device cannot run its layers
DropNetwork train_drop_network(Device& device, const std::vector<DropImage>& images,
                               const RefineOptions& options, std::uint64_t seed,
                               const RefineCallback& progress, const RefineState* start = nullptr);

class DropPass;

/// A network ready to be asked, in evaluation mode: the same image gives the same answer.
class DropRefiner {
public:
    /// @throws DataError where the arrays do not fit the network's shape; DeviceError as
    /// train_drop_network
    DropRefiner(Device& device, const DropNetwork& network);
    ~DropRefiner();
    DropRefiner(DropRefiner&&) noexcept;
    DropRefiner& operator=(DropRefiner&&) noexcept;

    const DropNetwork& network() const;
    /// Drop probability of each pixel [rows, columns]. @throws DataError as
    /// train_drop_network
    std::vector<float> refine(const DropImage& image);
    /// Milliseconds of kernels so far, by name, where the device has timestamps.
    const KernelTimes& times() const;
    /// The same network for images that are on the device,
    /// <relidar/diff/network_training.hpp>.
    DropPass& pass();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
