// SPDX-License-Identifier: Apache-2.0
// oneDNN 2 (Debian 12) and 3 (Debian 13) describe a primitive differently: 3 has no
// operation descriptors. Code that includes this is written for 3.
#pragma once

#include <oneapi/dnnl/dnnl.hpp>

namespace onednn {

#if DNNL_VERSION_MAJOR >= 3
using pooling_forward = dnnl::pooling_forward;
using pooling_backward = dnnl::pooling_backward;
#else
using pooling_forward = dnnl::pooling_v2_forward;  // with dilation, as all of 3
using pooling_backward = dnnl::pooling_v2_backward;
#endif

/// How a primitive computes, from the arguments of oneDNN 3's primitive_desc but for the
/// engine.
template <class Primitive, class... Arguments>
typename Primitive::primitive_desc describe(const dnnl::engine& engine, const Arguments&... arguments) {
#if DNNL_VERSION_MAJOR >= 3
    return {engine, arguments...};
#else
    return {typename Primitive::desc(arguments...), engine};
#endif
}

/// That of a backward pass. @param forward  what it is the derivative of
template <class Primitive, class Forward, class... Arguments>
typename Primitive::primitive_desc describe_backward(const dnnl::engine& engine, const Forward& forward,
                                                     const Arguments&... arguments) {
#if DNNL_VERSION_MAJOR >= 3
    return {engine, arguments..., forward};
#else
    return {typename Primitive::desc(arguments...), engine, forward};
#endif
}

/// Of batch normalisation; oneDNN 2 takes input and output to have one layout. @param
/// of_images  of both
inline dnnl::batch_normalization_forward::primitive_desc describe_norm(const dnnl::engine& engine,
                                                                       const dnnl::memory::desc& of_images,
                                                                       float epsilon,
                                                                       dnnl::normalization_flags flags) {
    using Norm = dnnl::batch_normalization_forward;
#if DNNL_VERSION_MAJOR >= 3
    return describe<Norm>(engine, dnnl::prop_kind::forward_training, of_images, of_images, epsilon, flags);
#else
    return describe<Norm>(engine, dnnl::prop_kind::forward_training, of_images, epsilon, flags);
#endif
}
inline dnnl::batch_normalization_backward::primitive_desc describe_norm_backward(
    const dnnl::engine& engine, const dnnl::batch_normalization_forward::primitive_desc& forward,
    const dnnl::memory::desc& of_images, float epsilon, dnnl::normalization_flags flags) {
    using Norm = dnnl::batch_normalization_backward;
#if DNNL_VERSION_MAJOR >= 3
    return describe_backward<Norm>(engine, forward, dnnl::prop_kind::backward, of_images, of_images,
                                   of_images, epsilon, flags);
#else
    return describe_backward<Norm>(engine, forward, dnnl::prop_kind::backward, of_images, of_images, epsilon,
                                   flags);
#endif
}

}  // namespace onednn
