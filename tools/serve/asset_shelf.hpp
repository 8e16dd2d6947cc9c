// SPDX-License-Identifier: Apache-2.0
// The assets that clients may put into scenes.
#pragma once

#include <string>
#include <vector>

#include <relidar/simulate/assets.hpp>

namespace relidar::serve {

/// Never changes.
class AssetShelf {
public:
    /// Reads what assets say of themselves: many of them are never used. Who puts one
    /// into a scene reads the rest.
    /// @param folders  of `relidar assets` @throws DataError where one cannot be read,
    /// UsageError for a name that two assets have
    explicit AssetShelf(const std::vector<std::string>& folders);

    struct Entry {
        std::filesystem::path folder;  ///< of the asset
        AssetFacts facts;
    };
    const std::vector<Entry>& entries() const { return entries_; }
    /// Null where there is none of that name.
    const Entry* find(const std::string& name) const;

private:
    std::vector<Entry> entries_;
};

}  // namespace relidar::serve
