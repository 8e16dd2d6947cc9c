// SPDX-License-Identifier: Apache-2.0
#include "asset_catalogue.hpp"

#include <algorithm>

#include "base/fail.hpp"

namespace relidar::serve {

AssetCatalogue::AssetCatalogue(const std::vector<std::string>& folders) {
    for (const std::string& folder : folders) {
        for (const std::filesystem::path& entry : list_assets(folder)) {
            AssetDescription facts = read_description(entry);
            if (const CatalogueEntry* same = find_asset(facts.name))
                fail<UsageError>(
                    "cannot serve the assets of {}: the asset {} is also in {}, expected different names",
                    folder, facts.name, same->folder.parent_path().string());
            entries_.push_back({entry, std::move(facts)});
        }
    }
}

const AssetCatalogue::CatalogueEntry* AssetCatalogue::find_asset(const std::string& asset_name) const {
    const auto entry =
        std::ranges::find_if(entries_, [&](const CatalogueEntry& e) { return e.facts.name == asset_name; });
    return entry == entries_.end() ? nullptr : &*entry;
}

}  // namespace relidar::serve
