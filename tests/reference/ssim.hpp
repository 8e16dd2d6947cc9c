// SPDX-License-Identifier: Apache-2.0
// Structural similarity of two intensity images (Wang et al. 2004) over a window of 11 x
// 11 pixels, Gaussian of 1.5 pixels, normalised over the known pixels it holds
// (docs/method.md section 5), in double, with its derivative.
#pragma once

#include <vector>

namespace relidar::reference {

struct Image {
    int rows = 0;
    int columns = 0;
    bool circular = false;    ///< the first column follows the last one
    std::vector<double> x;    ///< [rows,columns] rendered
    std::vector<double> y;    ///< [rows,columns] measured
    std::vector<bool> known;  ///< [rows,columns] others take no part
};

/// @param d_x  if given, receives the derivative by x [rows,columns]
/// @return mean of 1 - S over the known pixels; 0 where there are none
double ssim_loss(const Image& image, std::vector<double>* d_x = nullptr);

}  // namespace relidar::reference
