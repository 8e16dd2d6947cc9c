// SPDX-License-Identifier: Apache-2.0
// Computes the structural similarity of two intensity images (Wang et al. 2004) in
// double, with its derivative. The window is a Gaussian of 1.5 pixels over 11 x 11
// pixels, normalised over the known pixels in it (docs/method.md section 5).
#pragma once

#include <vector>

namespace relidar::reference {

struct Image {
    int rows = 0;
    int columns = 0;
    bool circular = false;    ///< the first column follows the last one
    std::vector<double> x;    ///< [rows,columns] rendered
    std::vector<double> y;    ///< [rows,columns] measured
    std::vector<bool> known;  ///< [rows,columns] false: the pixel is ignored
};

/// Computes the mean of 1 - S over the known pixels.
/// @param d_x if not null, receives the derivative with respect to x [rows,columns]
/// @return the mean, or 0 if no pixel is known
double ssim_loss(const Image& image, std::vector<double>* d_x = nullptr);

}  // namespace relidar::reference
