// SPDX-License-Identifier: Apache-2.0
// Images made smaller and larger again.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Half the rows and columns, rounded down.
Grid pooled(const Grid& grid);

class Resample {
public:
    explicit Resample(Device& device);

    /// Largest of 2 x 2. @param to  of the grid pooled(from.grid)
    void pool(Stream& stream, const Slice& from, const Slice& to);
    /// Adds dL/d(from) of pool() to d_from.
    void pool_vjp(Stream& stream, const Slice& from, const Slice& d_to, const Slice& d_from);
    /// Bilinear interpolation to the grid of `to`.
    void upsample(Stream& stream, const Slice& from, const Slice& to);
    /// dL/d(from) of upsample().
    void upsample_vjp(Stream& stream, const Slice& d_to, const Slice& d_from);

private:
    Kernel<shared::ResampleParams> pool_, pool_vjp_, upsample_, upsample_vjp_;
};

}  // namespace relidar::refine
