//! Optimal assignment of observations to tracks, each used at most once.
//!
//! In section 3.1.1 of the paper, every track takes the observation nearest to its expected
//! position, so two tracks may share one where objects cross. That causes tens of times more
//! identity switches than exclusive assignment. Here the sum of all costs is minimal (the Hungarian
//! method by shortest augmenting paths, Jonker and Volgenant). A track without an observation has a
//! cost, too.
//!
//! Cost: tracks x observations, and as much again for every track on an augmenting path.

use crate::limits::{MAX_OBSERVATIONS, MAX_TRACKS};

/// The columns of the cost matrix: the observations, and one per track for no observation.
const COLUMNS: usize = MAX_OBSERVATIONS + MAX_TRACKS;

/// Adds the best pairs of tracks without an observation and observations not `taken` to
/// `observation_of`, which has one entry per track.
///
/// `cost(track, observation)` is `None` for a forbidden pair. `miss_cost(track)` is the cost of a
/// track without an observation. Costs are finite.
///
/// # Panics
///
/// If there are more than [`MAX_TRACKS`] tracks or [`MAX_OBSERVATIONS`] observations, or if a cost
/// is not finite.
pub(crate) fn assign(
    observation_of: &mut [Option<usize>],
    taken: &mut [bool],
    cost: impl Fn(usize, usize) -> Option<f64>,
    unseen: impl Fn(usize) -> f64,
) {
    let mut free = [0; MAX_OBSERVATIONS];
    let mut n_free = 0;
    for (observation, _) in taken.iter().enumerate().filter(|(_, taken)| !**taken) {
        free[n_free] = observation;
        n_free += 1;
    }
    let free = &free[..n_free];
    let mut rows = [0; MAX_TRACKS];
    let mut n_rows = 0;
    for (track, given) in observation_of.iter().enumerate() {
        if given.is_none() && free.iter().any(|i| cost(track, *i).is_some()) {
            rows[n_rows] = track;
            n_rows += 1;
        }
    }
    let rows = &rows[..n_rows];
    let row_of = assign_rows(
        rows.len(),
        free.len() + rows.len(),
        |row, column| match free.get(column) {
            Some(observation) => cost(rows[row], *observation),
            None => (column - free.len() == row).then(|| unseen(rows[row])),
        },
    );
    for (observation, row) in free.iter().zip(row_of) {
        if let Some(row) = row {
            observation_of[rows[row]] = Some(*observation);
            taken[*observation] = true;
        }
    }
}

/// The row of every column, such that every row has a column and the sum of the costs is minimal.
/// Every row must have a column that is forbidden to all others.
fn assign_rows(
    n_rows: usize,
    n_columns: usize,
    cost: impl Fn(usize, usize) -> Option<f64>,
) -> [Option<usize>; COLUMNS] {
    let mut row_of = [None; COLUMNS];
    let (mut row_price, mut column_price) = ([0.0; MAX_TRACKS], [0.0; COLUMNS]);
    for new_row in 0..n_rows {
        // Dijkstra's search over reduced costs for the nearest free column.
        let mut distance = [f64::INFINITY; COLUMNS];
        let mut from = [None; COLUMNS];
        let mut done = [false; COLUMNS];
        let (mut row, mut column) = (new_row, None);
        let free_column = loop {
            let (mut next, mut step) = (0, f64::INFINITY);
            for other in (0..n_columns).filter(|other| !done[*other]) {
                if let Some(cost) = cost(row, other) {
                    let reduced = cost - row_price[row] - column_price[other];
                    if reduced < distance[other] {
                        distance[other] = reduced;
                        from[other] = column;
                    }
                }
                if distance[other] < step {
                    (next, step) = (other, distance[other]);
                }
            }
            assert!(step.is_finite(), "costs are finite");
            row_price[new_row] += step;
            for other in 0..n_columns {
                match (done[other], row_of[other]) {
                    (true, Some(row)) => {
                        let row: usize = row;
                        row_price[row] += step;
                        column_price[other] -= step;
                    }
                    _ => distance[other] -= step,
                }
            }
            done[next] = true;
            column = Some(next);
            match row_of[next] {
                Some(owner) => row = owner,
                None => break next,
            }
        };
        // Every row on the path moves on by one column.
        let mut to = free_column;
        while let Some(before) = from[to] {
            row_of[to] = row_of[before];
            to = before;
        }
        row_of[to] = Some(new_row);
    }
    row_of
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    const MISS_COST: f64 = 7.0;

    /// Minimum cost over all assignments, by definition.
    fn min_cost(costs: &[Vec<Option<u8>>], free: &mut [bool]) -> f64 {
        let Some((track, rest)) = costs.split_first() else {
            return 0.0;
        };
        let mut distance = MISS_COST + min_cost(rest, free);
        for (i, cost) in track.iter().enumerate() {
            if let Some(cost) = cost
                && free[i]
            {
                free[i] = false;
                distance = distance.min(f64::from(*cost) + min_cost(rest, free));
                free[i] = true;
            }
        }
        distance
    }

    #[test]
    fn minimizes_the_total_cost() {
        let costs = [[Some(2.0), Some(3.0)], [Some(1.0), None]];
        let mut observation_of = [None; 2];
        let mut taken = [false; 2];
        assign(
            &mut observation_of,
            &mut taken,
            |t, o| costs[t][o],
            |_| MISS_COST,
        );
        assert_eq!(observation_of, [Some(1), Some(0)]);
        assert_eq!(taken, [true; 2]);
    }

    #[test]
    fn a_track_is_missed_if_that_costs_less() {
        let costs = [[Some(1.0), Some(20.0)], [Some(5.0), None]];
        let mut observation_of = [None; 2];
        assign(
            &mut observation_of,
            &mut [false; 2],
            |t, o| costs[t][o],
            |_| MISS_COST,
        );
        assert_eq!(observation_of, [Some(0), None]);
    }

    #[test]
    fn keeps_existing_assignments() {
        let mut observation_of = [Some(1), None];
        let mut taken = [false, true];
        assign(
            &mut observation_of,
            &mut taken,
            |_, _| Some(0.0),
            |_| MISS_COST,
        );
        assert_eq!(observation_of, [Some(1), Some(0)]);
    }

    proptest! {
        /// Few distinct costs, so that ties are common.
        #[test]
        fn no_assignment_costs_less(
            costs in (0_usize..6).prop_flat_map(|n| {
                prop::collection::vec(prop::collection::vec(prop::option::of(0_u8..12), n), 0..6)
            }),
        ) {
            let n_observations = costs.first().map_or(0, Vec::len);
            let mut observation_of = vec![None; costs.len()];
            let mut taken = vec![false; n_observations];
            let cost = |t: usize, o: usize| costs[t][o].map(f64::from);
            assign(&mut observation_of, &mut taken, cost, |_| MISS_COST);
            let mut sum = 0.0;
            let mut used = vec![false; n_observations];
            for (track, observation) in observation_of.iter().enumerate() {
                sum += match observation {
                    Some(o) => {
                        prop_assert!(!std::mem::replace(&mut used[*o], true));
                        cost(track, *o).expect("an admissible pair")
                    }
                    None => MISS_COST,
                };
            }
            prop_assert_eq!(&used, &taken);
            prop_assert_eq!(sum, min_cost(&costs, &mut vec![true; n_observations]));
        }
    }
}
