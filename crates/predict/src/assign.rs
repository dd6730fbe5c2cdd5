//! Which observation belongs to which track: greedy, nearest pair first, each track and each observation used once.
//!
//! Section 3.1.1 of the paper gives every track the observation nearest to its expected place, so that two tracks
//! may share one where objects cross; that costs tens of times more identity switches than exclusive assignment,
//! while the optimal (Hungarian) assignment is hardly better than the greedy one. The result is that of sorting all
//! admissible pairs by distance and taking each whose track and observation are still free; no list of pairs is
//! needed, because only a track that loses its nearest observation to another has to look again.
//!
//! Cost: tracks x observations distances, and once more the observations for every lost conflict.

use crate::MAX_TRACKS;

/// Adds to `observation_of` (one entry a track) the greedy pairs among the tracks without an observation and the
/// observations not `taken`.
///
/// `distance(track, observation)` is `None` for a pair that must not be. Equal distances: the lower track, then the
/// lower observation first.
///
/// # Panics
///
/// If there are more than [`MAX_TRACKS`] tracks.
pub(crate) fn assign_nearest(
    observation_of: &mut [Option<usize>],
    taken: &mut [bool],
    distance: impl Fn(usize, usize) -> Option<f64>,
) {
    let nearest_free = |track: usize, taken: &[bool]| {
        let mut nearest: Option<(f64, usize)> = None;
        for (observation, _) in taken.iter().enumerate().filter(|(_, taken)| !**taken) {
            if let Some(candidate) = distance(track, observation)
                && nearest.is_none_or(|(best, _)| candidate < best)
            {
                nearest = Some((candidate, observation));
            }
        }
        nearest
    };

    let mut candidates = [None; MAX_TRACKS];
    let candidates = &mut candidates[..observation_of.len()];
    for (track, candidate) in candidates.iter_mut().enumerate() {
        if observation_of[track].is_none() {
            *candidate = nearest_free(track, taken);
        }
    }
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for (track, candidate) in candidates.iter().enumerate() {
            if let Some((distance, observation)) = *candidate
                && best.is_none_or(|(least, ..)| distance < least)
            {
                best = Some((distance, track, observation));
            }
        }
        let Some((_, winner, observation)) = best else {
            return;
        };
        observation_of[winner] = Some(observation);
        taken[observation] = true;
        candidates[winner] = None;
        for (track, candidate) in candidates.iter_mut().enumerate() {
            if candidate.is_some_and(|(_, wanted)| wanted == observation) {
                *candidate = nearest_free(track, taken);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// All admissible pairs, sorted, taken while free: the definition.
    fn assign_by_sorting(
        distances: &[Vec<Option<u8>>],
        n_observations: usize,
    ) -> Vec<Option<usize>> {
        let mut pairs = Vec::new();
        for (track, row) in distances.iter().enumerate() {
            for (observation, distance) in row.iter().enumerate() {
                pairs.extend(distance.map(|distance| (distance, track, observation)));
            }
        }
        pairs.sort_unstable();
        let mut observation_of = vec![None; distances.len()];
        let mut taken = vec![false; n_observations];
        for (_, track, observation) in pairs {
            if observation_of[track].is_none() && !taken[observation] {
                observation_of[track] = Some(observation);
                taken[observation] = true;
            }
        }
        observation_of
    }

    #[test]
    fn the_nearer_track_wins_and_the_loser_takes_the_next() {
        let distances = [[Some(2.0), Some(5.0)], [Some(1.0), None]];
        let mut observation_of = [None; 2];
        let mut taken = [false; 2];
        assign_nearest(&mut observation_of, &mut taken, |t, o| distances[t][o]);
        assert_eq!(observation_of, [Some(1), Some(0)]);
    }

    #[test]
    fn keeps_what_is_already_assigned() {
        let mut observation_of = [Some(1), None];
        let mut taken = [false, true];
        assign_nearest(&mut observation_of, &mut taken, |_, _| Some(0.0));
        assert_eq!(observation_of, [Some(1), Some(0)]);
    }

    proptest! {
        /// Few distinct distances, so that ties are common.
        #[test]
        fn equals_sorting_all_pairs(
            distances in (0_usize..9).prop_flat_map(|n| {
                prop::collection::vec(prop::collection::vec(prop::option::of(0_u8..12), n), 0..9)
            }),
        ) {
            let n_observations = distances.first().map_or(0, Vec::len);
            let mut observation_of = vec![None; distances.len()];
            let mut taken = vec![false; n_observations];
            assign_nearest(&mut observation_of, &mut taken, |t, o| distances[t][o].map(f64::from));
            prop_assert_eq!(observation_of, assign_by_sorting(&distances, n_observations));
        }
    }
}
