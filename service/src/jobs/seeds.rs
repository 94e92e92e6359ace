//! Seeds of jobs.

/// The seed of a scene's next job. It depends on nothing but the service's own seed and how many jobs the scene had, so
/// the same scene and the same edits give the same light map, bit for bit, where no job makes way for another: one that did
/// goes on from its map, with another seed.
pub(crate) fn next_seed(service: u64, jobs: &mut u64) -> u64 {
    *jobs += 1;
    mixed(jobs.wrapping_mul(0x9E37_79B9_7F4A_7C15)) ^ mixed(service)
}

/// SplitMix64's: neighbouring numbers, unrelated seeds. 0 stays 0.
pub(crate) fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_of_jobs_differ_by_job_and_by_service() {
        let of = |service| {
            let mut jobs = 0;
            [next_seed(service, &mut jobs), next_seed(service, &mut jobs)]
        };
        // Light maps that were made so far can be made again.
        assert_eq!(of(0), [0xe220_a839_7b1d_cdaf, 0x6e78_9e6a_a1b9_65f4]);
        assert!(of(1).iter().all(|seed| !of(0).contains(seed) && !of(2).contains(seed)));
        assert_eq!(of(7), of(7));
    }
}
