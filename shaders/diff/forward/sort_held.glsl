// SPDX-License-Identifier: Apache-2.0
// Sorts a hit list with at most HELD hits per lane. sort_hits.comp defines HELD, EACH and
// SORT_HITS_OF_LIST and then includes this file, once per list size.

#define LOAD(h)                                                           \
    {                                                                     \
        place[h] = h * LANES + lane;                                      \
        t[h] = 1e38;                                                      \
        if (place[h] < hit_count) t[h] = load_list_hit(list, place[h]).t; \
    }

// Each stage of the bitonic sort sorts blocks of `run` hits: even blocks in ascending
// order, odd blocks in descending order. True if hit h of this lane is in an even block.
#define IS_UPWARD(h) (((lane * HELD + h) & run) == 0u)

#define EXCHANGE_BETWEEN_LANES(h)                                                           \
    {                                                                                       \
        float other = subgroupShuffleXor(t[h], apart / HELD);                               \
        uint other_place = subgroupShuffleXor(place[h], apart / HELD);                      \
        bool other_first = other < t[h];                                                    \
        if (other == t[h]) other_first = is_before(list, hit_count, other_place, place[h]); \
        bool takes = other_first == (is_low == IS_UPWARD(h));                               \
        t[h] = takes ? other : t[h];                                                        \
        place[h] = takes ? other_place : place[h];                                          \
    }

#define EXCHANGE_WITHIN_LANE(h, by)                                                      \
    if ((h & by) == 0u) {                                                                \
        float low = t[h], high = t[h | by];                                              \
        uint low_place = place[h], high_place = place[h | by];                           \
        bool high_first = high < low;                                                    \
        if (high == low) high_first = is_before(list, hit_count, high_place, low_place); \
        bool swaps = high_first == IS_UPWARD(h);                                         \
        t[h] = swaps ? high : low;                                                       \
        t[h | by] = swaps ? low : high;                                                  \
        place[h] = swaps ? high_place : low_place;                                       \
        place[h | by] = swaps ? low_place : high_place;                                  \
    }
#define EXCHANGE_BY_1(h) EXCHANGE_WITHIN_LANE(h, 1u)
#define EXCHANGE_BY_2(h) EXCHANGE_WITHIN_LANE(h, 2u)
#define EXCHANGE_BY_4(h) EXCHANGE_WITHIN_LANE(h, 4u)
#define EXCHANGE_BY_8(h) EXCHANGE_WITHIN_LANE(h, 8u)

#define READ(h) \
    if (lane * HELD + h < hit_count) hits[h] = load_list_hit(list, place[h]);
#define STORE(h)                     \
    if (lane * HELD + h < hit_count) \
        params.lists.hits.at[hit_list_index(params.lists.room, list, lane * HELD + h)] = hits[h];

/// Sorts one list with a bitonic sort. Each lane holds HELD consecutive hits, so close
/// pairs are exchanged within a lane and distant pairs by subgroup shuffles.
void SORT_HITS_OF_LIST(uint list, uint hit_count) {
    uint lane = gl_SubgroupInvocationID, place[HELD];
    float t[HELD];
    EACH(LOAD)
    for (uint run = 2u; run <= HELD * LANES; run *= 2u) {
        for (uint apart = run / 2u; apart >= HELD; apart /= 2u) {
            bool is_low = (lane & (apart / HELD)) == 0u;
            EACH(EXCHANGE_BETWEEN_LANES)
        }
#if HELD > 8
        if (run > 8u) { EACH(EXCHANGE_BY_8) }
#endif
#if HELD > 4
        if (run > 4u) { EACH(EXCHANGE_BY_4) }
#endif
#if HELD > 2
        if (run > 2u) { EACH(EXCHANGE_BY_2) }
#endif
#if HELD > 1
        EACH(EXCHANGE_BY_1)
#endif
    }
    Hit hits[HELD];
    EACH(READ)
    subgroupBarrier();  // waits until all lanes have read their hits
    EACH(STORE)
}

#undef LOAD
#undef IS_UPWARD
#undef EXCHANGE_BETWEEN_LANES
#undef EXCHANGE_WITHIN_LANE
#undef EXCHANGE_BY_1
#undef EXCHANGE_BY_2
#undef EXCHANGE_BY_4
#undef EXCHANGE_BY_8
#undef READ
#undef STORE
#undef HELD
#undef EACH
#undef SORT_HITS_OF_LIST
